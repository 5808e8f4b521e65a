/* The functions of the model @NAME@. See palpate.h. */
#ifndef PALPATE_MODEL_@NAME@_H
#define PALPATE_MODEL_@NAME@_H

#include "palpate.h"

#ifdef __cplusplus
extern "C" {
#endif

int32_t @NAME@_step(void *memory);     /* take a period towards "pose", and write "record" and "force_bound" */
int32_t @NAME@_reset(void *memory);    /* body and tools to rest */
int32_t @NAME@_set_tool(void *memory); /* another tool in place of one, from the arrays "tool_..." */
int32_t @NAME@_vertices(void *memory); /* write "vertices" */
int32_t @NAME@_check(void *memory);    /* 0 if the memory has the content of this model's file */
int64_t @NAME@_memory_size(void);
int64_t @NAME@_file_size(void);

/* Read the model's file. Returns PALPATE_OK or another status; free(*block) ends the model. */
static int @NAME@_open(const char *path, void **block, void **memory) {
    return palpate_read(path, @NAME@_memory_size(), @NAME@_file_size(), @NAME@_check, block, memory);
}

#ifdef __cplusplus
}
#endif
#endif
