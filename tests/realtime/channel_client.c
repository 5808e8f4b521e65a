/* Presses through the channel NAME for some periods, and prints times of the exchange [us] and the last record.
   Usage: NAME PERIODS */
#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "palpate_channel.h"

static double now(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return 1e6 * (double)time.tv_sec + 1e-3 * (double)time.tv_nsec;
}

static int by_size(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(int argc, char **argv) {
    double pose[7] = {0, 0, 0, 1, 0, 0, 0}, record[PALPATE_CHANNEL_SIZE], *exchange, *round;
    int count = argc > 2 ? atoi(argv[2]) : 0, k;
    palpate_channel channel;
    if (count < 1 || palpate_channel_open(&channel, argv[1])) return 2;
    exchange = (double *)malloc(2 * (size_t)count * sizeof(double));
    if (!exchange) return 3;
    round = exchange + count;
    for (k = 0; k < count; k++) {
        double began = now(), end;
        pose[2] = -0.004 * (k + 1) / count;
        palpate_channel_write(&channel, pose, k + 1);
        while (palpate_channel_read(&channel, record)) {}
        exchange[k] = now() - began;
        end = began + 1e6;
        while (record[PALPATE_CHANNEL_SEQUENCE] < k + 1 && now() < end) {
            struct timespec pause = {0, 20000};
            nanosleep(&pause, NULL);
            while (palpate_channel_read(&channel, record)) {}
        }
        if (record[PALPATE_CHANNEL_SEQUENCE] < k + 1) return 4;
        round[k] = now() - began;
    }
    pose[0] = 0.0 / (count - count + 0.0); /* not a number: the last pose is kept */
    palpate_channel_write(&channel, pose, count + 1);
    qsort(exchange, (size_t)count, sizeof *exchange, by_size);
    qsort(round, (size_t)count, sizeof *round, by_size);
    printf("%.3f %.3f %.3f %.3f\n", exchange[count / 2], exchange[(int)(0.999 * count)], round[count / 2],
           round[(int)(0.999 * count)]);
    printf("%.17g %.17g %.17g\n", record[PALPATE_CHANNEL_POSITION + 2], record[PALPATE_CHANNEL_FORCE + 2],
           record[PALPATE_CHANNEL_TIME]);
    free(exchange);
    return 0;
}
