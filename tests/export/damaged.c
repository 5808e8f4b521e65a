/* Reads damaged copies of the file of the model organ, and prints how many were refused. Usage: FILE SCRATCH COUNT SEED */
#include "organ.h"

static uint64_t state;

static uint64_t next_random(void) { /* xorshift64, G. Marsaglia 2003 */
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state;
}

int main(int argc, char **argv) {
    long size, k, refused = 0, count = argc > 4 ? atol(argv[3]) : 0;
    unsigned char *content;
    FILE *file = argc > 4 ? fopen(argv[1], "rb") : NULL;
    if (!file) return 2;
    state = 88172645463325252u + (uint64_t)atol(argv[4]);
    size = (long)organ_file_size();
    content = (unsigned char *)malloc((size_t)size + 64);
    if (!content || fread(content, 1, (size_t)size, file) != (size_t)size) return 3;
    fclose(file);
    for (k = 0; k < count; k++) {
        unsigned char before[64];
        long place = (long)(next_random() % (uint64_t)(k % 2 ? size : 4096)), length = size, span, i;
        void *block, *memory;
        span = 1 + (long)(next_random() % 8);
        if (place + span > size) span = size - place;
        memcpy(before, content + place, (size_t)span);
        if (k % 7 == 0) {
            length = (long)(next_random() % (uint64_t)size); /* cut short */
        } else if (k % 7 == 1) {
            length = size + 1 + (long)(next_random() % 63); /* longer */
        } else {
            for (i = 0; i < span; i++) content[place + i] ^= (unsigned char)(1 + next_random() % 255);
            if (k % 7 == 2) memset(content + 24, 0xff, 8); /* a lie about the length */
        }
        file = fopen(argv[2], "wb");
        if (!file || fwrite(content, 1, (size_t)length, file) != (size_t)length) return 4;
        fclose(file);
        refused += organ_open(argv[2], &block, &memory) == PALPATE_BAD_FILE && !block && !memory;
        memcpy(content + place, before, (size_t)span);
        if (k % 7 == 2) {
            uint64_t stored = (uint64_t)size;
            memcpy(content + 24, &stored, 8);
        }
    }
    printf("%ld of %ld\n", refused, count);
    free(content);
    return refused == count ? 0 : 1;
}
