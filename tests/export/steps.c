/* Steps the model organ through poses of a file, and writes the record of every period to the standard output. */
#include "organ.h"

int main(int argc, char **argv) {
    void *block, *memory;
    double *pose, *record, *sizes, *place;
    uint32_t count;
    FILE *poses;
    int status = argc > 2 ? organ_open(argv[1], &block, &memory) : PALPATE_NO_FILE;
    if (status) return 10 + status;
    poses = fopen(argv[2], "rb");
    if (!poses) return 2;
    pose = (double *)palpate_array(memory, "pose");
    record = (double *)palpate_array(memory, "record");
    sizes = (double *)palpate_array(memory, "tool_sizes");
    place = (double *)palpate_array(memory, "tool_pose");
    count = palpate_rows(memory, "record");
    if (fread(place, sizeof(double), 7, poses) != 7 || fread(sizes, sizeof(double), 3, poses) != 3) return 3;
    *(int64_t *)palpate_array(memory, "tool_kind") = PALPATE_CAPSULE;
    *(double *)palpate_array(memory, "tool_friction") = 0.3;
    if (organ_set_tool(memory)) return 4;
    while (fread(pose, sizeof(double), 7, poses) == 7) {
        if (organ_step(memory)) return 5;
        fwrite(record, sizeof(double), count, stdout);
    }
    fclose(poses);
    free(block);
    return 0;
}
