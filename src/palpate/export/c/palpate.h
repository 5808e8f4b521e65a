/* A model of palpate in C: the 1 kHz step of soft tissue under tools, without Python.

   One block of memory per model. No function allocates, locks, or keeps state elsewhere, so that a copy of the memory
   (memcpy) is another model in the same state. One thread at a time may use a memory. Lengths in m, forces in N.

   Arrays of the memory, which palpate_array() finds by name:

   double  pose[k][7]         requested positions and unit quaternions (w, x, y, z) of k tools, relative to the tools
                              at rest; palpate_set_pose() writes one
   double  record[]           results of the last period; the indices are PALPATE_TIME, PALPATE_FORCE, ... below, for
                              the first tool; palpate_tool() returns the part of each tool; then come coordinates
   double  force_bound[k]     error bounds of the forces [N], infinite where they are not known
   float   vertices[n][3]     positions of the surface, after NAME_vertices()
   float   rest[n][3]         positions at rest
   uint8   fixed[n]           1 for vertices of supports
   uint32  triangles[t][3]    vertices of its triangles, counter-clockwise from outside
   double  tool_position[k][3] displacements of the tools, which differ from the poses with a coupling
   double  options[6]         period [s], largest force [N], largest speeds [m/s] and [rad/s] of a tool, periods
                              between evaluations of the contact stiffness, and the response to an error indicator above 1
   double  modulus_ratio[2]   present and requested ratio of all moduli to those of the model
   double  coupling[k][4]     springs between devices and tools: stiffness [N/m] (0: none), damping, mass, largest force
   int64   tool_index[1]      for NAME_set_tool(): the tool, from 0
   int64   tool_kind[1]       PALPATE_CAPSULE, ..., or PALPATE_NONE
   double  tool_sizes[3]      capsule: radius, half length, 0 (a ball has half length 0); plane: zeros; punch:
                              radius, 0, radius of the rounding; forceps: radius, 0, 0
   double  tool_friction[1]   coefficient
   double  tool_point[3]      forceps: centre of the ball of held nodes, on the body at rest
   double  tool_pose[7]       from then on, poses are relative to this one */
#ifndef PALPATE_H
#define PALPATE_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { /* status of a function */
    PALPATE_OK = 0,
    PALPATE_BAD_POSE = 1,  /* not finite, or more than 1 m from the last: the period was taken with the last one */
    PALPATE_DIVERGED = 2,  /* nothing moves until NAME_reset(), and the force is zero */
    PALPATE_BAD_VALUE = 3, /* an option or a tool is out of range, or forceps hold nodes of others: nothing was done */
    PALPATE_NO_FILE = 4,   /* the file cannot be read */
    PALPATE_BAD_FILE = 5,  /* the file is damaged, or belongs to another library */
    PALPATE_NO_MEMORY = 6
};

enum { /* response to an error indicator above 1, where the model was not trained */
    PALPATE_CLAMP = 1, /* keep the tools at the last trusted poses, until the requested ones have returned */
    PALPATE_IGNORE = 3
};

enum { PALPATE_NONE = -1, @KINDS@ }; /* kinds of tools */

enum { /* indices of the record; the parts of tools follow its header */
@RECORD@
};

enum { /* indices of the part of a tool */
@TOOL_RECORD@
};

typedef struct {
    char name[24];
    uint64_t offset;
    uint32_t type, rows, columns, reserved; /* type: 0 double, 1 float, 2 int64, 3 uint32, 5 uint8 */
} palpate_entry;

static const palpate_entry *palpate_describe(const void *memory, const char *name) {
    const palpate_entry *entry = (const palpate_entry *)((const char *)memory + 64);
    uint32_t count;
    memcpy(&count, (const char *)memory + 12, 4);
    for (; count; count--, entry++)
        if (strncmp(entry->name, name, sizeof entry->name) == 0) return entry;
    return NULL;
}

/* Return an array of a model by its name; NULL if there is none. */
static void *palpate_array(void *memory, const char *name) {
    const palpate_entry *entry = palpate_describe(memory, name);
    return entry ? (char *)memory + entry->offset : NULL;
}

/* Return the number of rows of an array, 0 if there is none. */
static uint32_t palpate_rows(const void *memory, const char *name) {
    const palpate_entry *entry = palpate_describe(memory, name);
    return entry ? entry->rows : 0;
}

/* Request a pose of a tool, from 0; returns PALPATE_BAD_VALUE if there is no such tool. */
static inline int palpate_set_pose(void *memory, uint32_t tool, const double pose[7]) {
    if (tool >= palpate_rows(memory, "pose")) return PALPATE_BAD_VALUE;
    memcpy((double *)palpate_array(memory, "pose") + 7 * (size_t)tool, pose, 7 * sizeof *pose);
    return PALPATE_OK;
}

/* Return the results of a tool, from 0, with the indices PALPATE_TOOL_FORCE, ...; NULL if there is no such tool. */
static inline const double *palpate_tool(void *memory, uint32_t tool) {
    const double *record = (const double *)palpate_array(memory, "record");
    if (tool >= palpate_rows(memory, "pose")) return NULL;
    return record + PALPATE_HEADER_SIZE + PALPATE_TOOL_SIZE * (size_t)tool;
}

/* Read a file into new memory, which free(*block) releases. It is used only after `check` has accepted it. */
static int palpate_read(const char *path, int64_t memory_size, int64_t file_size, int32_t (*check)(void *),
                        void **block, void **memory) {
    FILE *file = fopen(path, "rb");
    int complete;
    *block = *memory = NULL;
    if (!file) return PALPATE_NO_FILE;
    *block = malloc((size_t)memory_size + 64);
    if (!*block) {
        fclose(file);
        return PALPATE_NO_MEMORY;
    }
    *memory = (void *)(((uintptr_t)*block + 63) & ~(uintptr_t)63);
    memset(*memory, 0, (size_t)memory_size);
    complete = fread(*memory, 1, (size_t)file_size, file) == (size_t)file_size && fgetc(file) == EOF;
    fclose(file);
    if (complete && check(*memory) == 0) return PALPATE_OK;
    free(*block);
    *block = *memory = NULL;
    return PALPATE_BAD_FILE;
}

#ifdef __cplusplus
}
#endif
#endif
