/* Pose in, force out: the channel between an engine of palpate with shared_memory="NAME" and a program on this machine.
   Include it in one C or C++ file; on older Linux link with -lrt. One program may write poses, any number may read.
   The forces of an old record are zero: the engine has paused, stopped, failed or died. */
#ifndef PALPATE_CHANNEL_H
#define PALPATE_CHANNEL_H

#include <stdint.h>
#include <string.h>
#ifdef _WIN32
#include <windows.h>
#else
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>
#endif

enum { /* indices of a record; SI units; position and quaternion (w, x, y, z) are relative to the tool at rest */
    PALPATE_CHANNEL_TIME = 0, PALPATE_CHANNEL_PERIODS = 1, PALPATE_CHANNEL_FAILED = 2, PALPATE_CHANNEL_TRUST = 6,
    PALPATE_CHANNEL_SEQUENCE = 11, PALPATE_CHANNEL_POSITION = 14, PALPATE_CHANNEL_QUATERNION = 17,
    PALPATE_CHANNEL_FORCE = 21, PALPATE_CHANNEL_MOMENT = 24, PALPATE_CHANNEL_STIFFNESS = 27, PALPATE_CHANNEL_SIZE = 36
};

enum { /* indices of the part of a tool, of engines with several */
    PALPATE_CHANNEL_TOOL_POSITION = 0, PALPATE_CHANNEL_TOOL_QUATERNION = 3, PALPATE_CHANNEL_TOOL_FORCE = 7,
    PALPATE_CHANNEL_TOOL_MOMENT = 10, PALPATE_CHANNEL_TOOL_STIFFNESS = 13, PALPATE_CHANNEL_TOOL_LARGEST_FORCE = 22,
    PALPATE_CHANNEL_TOOL_LIMITED = 23, PALPATE_CHANNEL_TOOL_SEQUENCE = 24, PALPATE_CHANNEL_TOOL_SIZE = 25
};

typedef struct {
    int64_t *pose_version, *record_version; /* odd during a write */
    double *pose, *record;
    int64_t *more_versions; /* of the poses of the tools after the first, 16 each */
    double *more_poses; /* 8 each */
    int64_t tools;
} palpate_channel;

/* Open the channel NAME; returns 0, or -1 if no engine that runs has it. */
static int palpate_channel_open(palpate_channel *channel, const char *name) {
    int64_t process, numbers, tools;
    char path[128] = "", *memory;
#ifdef _WIN32
    HANDLE file;
    strncat(path, name, 100);
    file = OpenFileMappingA(FILE_MAP_ALL_ACCESS, FALSE, path);
    if (!file || !(memory = (char *)MapViewOfFile(file, FILE_MAP_ALL_ACCESS, 0, 0, 0))) return -1;
#else
    off_t size;
    int file;
    strcat(path, "/");
    strncat(path, name, 100);
    file = shm_open(path, O_RDWR, 0);
    if (file < 0 || (size = lseek(file, 0, SEEK_END)) < 64 + 128 + 64 + 128 + 8 * PALPATE_CHANNEL_SIZE) return -1;
    memory = (char *)mmap(NULL, (size_t)size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (memory == (char *)MAP_FAILED) return -1;
#endif
    if (memcmp(memory, "PALPATE\2", 8) != 0) return -1;
    memcpy(&process, memory + 8, 8);
    memcpy(&numbers, memory + 16, 8);
    memcpy(&tools, memory + 24, 8);
#ifndef _WIN32
    if (kill((pid_t)process, 0) != 0 && errno == ESRCH) return -1; /* the engine left its memory behind */
#endif
    channel->pose_version = (int64_t *)(memory + 64);
    channel->pose = (double *)(memory + 64 + 128);
    channel->record_version = (int64_t *)(memory + 64 + 128 + 64);
    channel->record = (double *)(memory + 64 + 128 + 64 + 128);
    channel->tools = tools;
    channel->more_versions = (int64_t *)(channel->record + numbers);
    channel->more_poses = (double *)(channel->more_versions + 16 * (tools - 1));
    return 0;
}

/* Request a pose of a tool, from 0: position [m] and quaternion; records return its number once they include it. Never
   waits. Each tool may have a program of its own. Returns 0, or -1 if there is no such tool. */
static inline int palpate_channel_write_tool(palpate_channel *channel, int tool, const double pose[7], double number) {
    int64_t *at = tool ? channel->more_versions + 16 * (tool - 1) : channel->pose_version, version, bits;
    double *values = tool ? channel->more_poses + 8 * (tool - 1) : channel->pose, value;
    int i;
    if (tool < 0 || tool >= channel->tools) return -1;
    version = __atomic_load_n(at, __ATOMIC_RELAXED);
    __atomic_store_n(at, version + 1, __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_RELEASE);
    for (i = 0; i < 8; i++) {
        value = i < 7 ? pose[i] : number;
        memcpy(&bits, &value, 8);
        __atomic_store_n((int64_t *)values + i, bits, __ATOMIC_RELAXED);
    }
    __atomic_store_n(at, version + 2, __ATOMIC_RELEASE);
    return 0;
}

/* Request a pose of the first tool. */
static inline void palpate_channel_write(palpate_channel *channel, const double pose[7], double number) {
    (void)palpate_channel_write_tool(channel, 0, pose, number);
}

/* Return the age of the newest record [s]. */
static double palpate_channel_age(const palpate_channel *channel) {
    const int64_t written = __atomic_load_n(channel->record_version + 1, __ATOMIC_RELAXED);
#ifdef _WIN32
    LARGE_INTEGER count, rate;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&rate);
    return (double)count.QuadPart / (double)rate.QuadPart - 1e-9 * (double)written;
#else
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e-9 * (double)((int64_t)now.tv_sec * 1000000000 + now.tv_nsec - written);
#endif
}

/* Copy numbers of the newest record from the first on, with 15 of force, moment and stiffness from `force` on. */
static inline int palpate_channel_copy(const palpate_channel *channel, int first, int count, int force, double *out) {
    int64_t version = __atomic_load_n(channel->record_version, __ATOMIC_ACQUIRE), bits;
    int i;
    const double max_age = 1e-9 * (double)__atomic_load_n(channel->record_version + 2, __ATOMIC_RELAXED);
    if ((version & 1) && palpate_channel_age(channel) < max_age) return -1;
    for (i = 0; i < count; i++) {
        bits = __atomic_load_n((int64_t *)channel->record + first + i, __ATOMIC_RELAXED);
        memcpy(&out[i], &bits, 8);
    }
    __atomic_thread_fence(__ATOMIC_ACQUIRE);
    if (!(palpate_channel_age(channel) < max_age)) {
        for (i = force; i < force + 15; i++) out[i] = 0;
        return 0;
    }
    return __atomic_load_n(channel->record_version, __ATOMIC_RELAXED) == version ? 0 : -1;
}

/* Copy the newest record, of the first tool; returns 0, or -1 if the engine was writing at that moment: then call it
   again. Force, moment and stiffness are zero if it is older than 20 ms or, if that is longer, four periods. */
static inline int palpate_channel_read(const palpate_channel *channel, double record[PALPATE_CHANNEL_SIZE]) {
    return palpate_channel_copy(channel, 0, PALPATE_CHANNEL_SIZE, PALPATE_CHANNEL_FORCE, record);
}

/* Copy the newest results of a tool, from 0, as `palpate_channel_read`; returns -2 if there is no such tool. */
static inline int palpate_channel_read_tool(const palpate_channel *channel, int tool, double part[PALPATE_CHANNEL_TOOL_SIZE]) {
    const int first = PALPATE_CHANNEL_SIZE + PALPATE_CHANNEL_TOOL_SIZE * tool;
    if (tool < 0 || tool >= channel->tools) return -2;
    return palpate_channel_copy(channel, first, PALPATE_CHANNEL_TOOL_SIZE, PALPATE_CHANNEL_TOOL_FORCE, part);
}

#endif
