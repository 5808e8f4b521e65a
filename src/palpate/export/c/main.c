/* Presses the model @NAME@ with a ball at 1 kHz, and prints forces and deadline statistics.

       press [@NAME@.palpate] [seconds] */
#ifndef _WIN32
#define _POSIX_C_SOURCE 200112L
#endif
#include <math.h>
#include <time.h>

#include "@NAME@.h"

#ifdef _WIN32
#include <windows.h>
static double now(void) {
    LARGE_INTEGER count, rate;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&rate);
    return (double)count.QuadPart / (double)rate.QuadPart;
}
static void wait_until(double time) {
    while (time - now() > 2e-3) Sleep(1);
    while (now() < time) {}
}
#else
static double now(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}
static void wait_until(double time) {
    double left = time - now() - 50e-6; /* poll the clock for the last 50 us */
    struct timespec rest;
    if (left > 0) {
        rest.tv_sec = (time_t)left;
        rest.tv_nsec = (long)(1e9 * (left - (double)rest.tv_sec));
        nanosleep(&rest, NULL);
    }
    while (now() < time) {}
}
#endif

static int by_size(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void print_times(const char *what, double *times, int count) {
    qsort(times, (size_t)count, sizeof *times, by_size);
    printf("%s: median %.1f us, 99 %% %.1f us, largest %.1f us\n", what, 1e6 * times[count / 2],
           1e6 * times[(int)(0.99 * count)], 1e6 * times[count - 1]);
}

int main(int argc, char **argv) {
    static const double point[3] = {@POINT@}, inward[3] = {@INWARD@}; /* on the surface at rest */
    const double radius = @RADIUS@, depth = @DEPTH@, clearance = 0.002, period = 1e-3;
    const char *path = argc > 1 ? argv[1] : "@NAME@.palpate";
    const int count = (int)((argc > 2 ? atof(argv[2]) : 5.0) / period);
    double pose[7] = {0, 0, 0, 1, 0, 0, 0}, *record, *bound, *tool_pose, *sizes, *computing, *lateness, began, start;
    int64_t *kind;
    int k, i, missed = 0, status;
    void *block, *memory;

    status = @NAME@_open(path, &block, &memory);
    if (status) {
        fprintf(stderr, "%s: %s\n", path, status == PALPATE_BAD_FILE ? "damaged, or of another library" : "no such file");
        return 1;
    }
    record = (double *)palpate_array(memory, "record");
    bound = (double *)palpate_array(memory, "force_bound");
    kind = (int64_t *)palpate_array(memory, "tool_kind");
    sizes = (double *)palpate_array(memory, "tool_sizes");
    tool_pose = (double *)palpate_array(memory, "tool_pose");
    computing = (double *)calloc((size_t)(2 * count + 2), sizeof(double));
    if (count < 1 || !computing) return 1;
    lateness = computing + count;

    if (@TAKES_TOOLS@) { /* a ball just outside the surface */
        *kind = PALPATE_CAPSULE;
        sizes[0] = radius;
        for (i = 0; i < 3; i++) tool_pose[i] = point[i] - (radius + clearance) * inward[i];
        if (@NAME@_set_tool(memory)) return 1;
    }
    start = now() + period;
    for (k = 0; k < count; k++) {
        double share = sin(3.14159265358979 * k * period); /* a press every second */
        double deadline = start + k * period;
        wait_until(deadline);
        began = now();
        for (i = 0; i < 3; i++) pose[i] = (depth + clearance) * share * share * inward[i];
        palpate_set_pose(memory, 0, pose);
        status = @NAME@_step(memory);
        if (status) {
            fprintf(stderr, "status %d after %d periods\n", status, k);
            return 1;
        }
        computing[k] = now() - began;
        lateness[k] = began - deadline;
        missed += computing[k] + lateness[k] > period;
        if (k % 250 == 0)
            printf("%.2f s: force %+.4f %+.4f %+.4f N, error at most %.3g N, trust %.2f\n", record[PALPATE_TIME],
                   record[PALPATE_FORCE], record[PALPATE_FORCE + 1], record[PALPATE_FORCE + 2], *bound,
                   record[PALPATE_TRUST]);
    }
    print_times("computing", computing, count);
    print_times("lateness", lateness, count);
    printf("%d of %d deadlines missed\n", missed, count);
    free(computing);
    free(block);
    return 0;
}
