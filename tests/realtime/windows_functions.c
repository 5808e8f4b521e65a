/* Functions of Windows' kernel32, in terms of POSIX: what the compiled clocks of Windows call, on another system. */
#include <stdint.h>
#include <stdlib.h>
#include <time.h>

static int open_timers;

int QueryPerformanceFrequency(int64_t *frequency) {
    *frequency = 10000000;
    return 1;
}

int QueryPerformanceCounter(int64_t *count) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    *count = (int64_t)time.tv_sec * 10000000 + time.tv_nsec / 100;
    return 1;
}

void *CreateWaitableTimerExW(void *attributes, void *name, uint32_t flags, uint32_t access) {
    if (attributes || name || flags != 2 || access != 0x1F0003) abort();
    open_timers++;
    return calloc(1, sizeof(int64_t));
}

int SetWaitableTimer(void *timer, const int64_t *due, int32_t period, void *routine, void *argument, int resume) {
    if (*due >= 0 || period || routine || argument || resume) abort(); /* a duration, once */
    *(int64_t *)timer = -*due;
    return 1;
}

uint32_t WaitForSingleObject(void *timer, uint32_t milliseconds) {
    int64_t ticks = *(int64_t *)timer;
    struct timespec rest = {ticks / 10000000, 100 * (ticks % 10000000)};
    if (milliseconds != 0xFFFFFFFF) abort();
    nanosleep(&rest, NULL);
    return 0;
}

int CloseHandle(void *timer) {
    open_timers--;
    free(timer);
    return 1;
}

int count_open_timers(void) { return open_timers; }
