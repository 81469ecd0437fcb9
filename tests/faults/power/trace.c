/* Preloaded: takes down each write, sync, creation, truncation, renaming and removal of files in one folder, in order.

   POWER_FOLDER is the folder (with a slash at its end), POWER_TRACE the file to write to. An entry: the operation,
   length of the name, place in the file, length of the data; name; data. Operations are done one after the other,
   threads wait. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

static pthread_mutex_t turn = PTHREAD_MUTEX_INITIALIZER;
static int trace = -1;
static const char *folder;
static size_t folder_length;

struct head { uint8_t what; uint8_t pad[3]; uint32_t name; int64_t at; int64_t length; };

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("POWER_TRACE");
    folder = getenv("POWER_FOLDER");
    if (!path || !folder) return;
    folder_length = strlen(folder);
    trace = syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
}

static void put(char what, const char *name, int64_t at, const void *data, int64_t length) {
    struct head head = {what, {0}, strlen(name), at, length};
    struct iovec parts[3] = {{&head, sizeof head}, {(void *)name, head.name}, {(void *)data, data ? length : 0}};
    if (syscall(SYS_writev, trace, parts, 3) < 0) abort();
}

static const char *inside(const char *path) {
    return trace >= 0 && path && !strncmp(path, folder, folder_length) ? path + folder_length : NULL;
}

static const char *named(int fd, char *space) {
    char link[64];
    if (trace < 0) return NULL;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, space, 4000);
    if (length < 0) return NULL;
    space[length] = 0;
    if (!strcmp(space + length - (length > 10 ? 10 : 0), " (deleted)")) return NULL;
    if ((size_t)length == folder_length - 1 && !strncmp(space, folder, length)) return "/";
    return inside(space);
}

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = (type (*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

static int opened(int (*real)(int, const char *, int, ...), int at, const char *path, int flags, mode_t mode) {
    const char *name = inside(path);
    if (!name) return real(at, path, flags, mode);
    pthread_mutex_lock(&turn);
    int there = !syscall(SYS_faccessat, AT_FDCWD, path, F_OK);
    int fd = real(at, path, flags, mode);
    if (fd >= 0 && !there) put('C', name, 0, NULL, 0);
    if (fd >= 0 && there && (flags & O_TRUNC)) put('T', name, 0, NULL, 0);
    pthread_mutex_unlock(&turn);
    return fd;
}

#define OPENAT(function) \
    int function(int at, const char *path, int flags, ...) { \
        va_list rest; va_start(rest, flags); mode_t mode = va_arg(rest, mode_t); va_end(rest); \
        REAL(int, "openat64", int, const char *, int, ...); \
        return opened(real, at, path, flags, mode); \
    }
OPENAT(openat)
OPENAT(openat64)
#define OPEN(function) \
    int function(const char *path, int flags, ...) { \
        va_list rest; va_start(rest, flags); mode_t mode = va_arg(rest, mode_t); va_end(rest); \
        REAL(int, "openat64", int, const char *, int, ...); \
        return opened(real, AT_FDCWD, path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

#define PWRITE(function) \
    ssize_t function(int fd, const void *data, size_t length, off64_t at) { \
        char space[4096]; const char *name = named(fd, space); \
        if (!name) return syscall(SYS_pwrite64, fd, data, length, at); \
        pthread_mutex_lock(&turn); \
        ssize_t done = syscall(SYS_pwrite64, fd, data, length, at); \
        if (done > 0) put('W', name, at, data, done); \
        pthread_mutex_unlock(&turn); \
        return done; \
    }
PWRITE(pwrite)
PWRITE(pwrite64)

ssize_t write(int fd, const void *data, size_t length) {
    char space[4096]; const char *name = named(fd, space);
    if (!name) return syscall(SYS_write, fd, data, length);
    pthread_mutex_lock(&turn);
    int64_t at = syscall(SYS_lseek, fd, 0, SEEK_CUR);
    ssize_t done = syscall(SYS_write, fd, data, length);
    if (done > 0) put('W', name, at, data, done);
    pthread_mutex_unlock(&turn);
    return done;
}

#define TRUNCATE(function) \
    int function(int fd, off64_t length) { \
        char space[4096]; const char *name = named(fd, space); \
        if (!name) return syscall(SYS_ftruncate, fd, length); \
        pthread_mutex_lock(&turn); \
        int done = syscall(SYS_ftruncate, fd, length); \
        if (!done) put('T', name, length, NULL, 0); \
        pthread_mutex_unlock(&turn); \
        return done; \
    }
TRUNCATE(ftruncate)
TRUNCATE(ftruncate64)

#define SYNC(function, number) \
    int function(int fd) { \
        char space[4096]; const char *name = named(fd, space); \
        if (!name) return syscall(number, fd); \
        pthread_mutex_lock(&turn); \
        int done = syscall(number, fd); \
        if (!done) put(*name == '/' ? 'D' : 'S', name, 0, NULL, 0); \
        pthread_mutex_unlock(&turn); \
        return done; \
    }
SYNC(fsync, SYS_fsync)
SYNC(fdatasync, SYS_fdatasync)

int rename(const char *from, const char *to) {
    const char *name = inside(from), *other = inside(to);
    if (!name || !other) return syscall(SYS_renameat2, AT_FDCWD, from, AT_FDCWD, to, 0);
    pthread_mutex_lock(&turn);
    int done = syscall(SYS_renameat2, AT_FDCWD, from, AT_FDCWD, to, 0);
    if (!done) put('R', name, 0, other, strlen(other));
    pthread_mutex_unlock(&turn);
    return done;
}

static int removed(const char *path) {
    const char *name = inside(path);
    if (!name) return syscall(SYS_unlinkat, AT_FDCWD, path, 0);
    pthread_mutex_lock(&turn);
    int done = syscall(SYS_unlinkat, AT_FDCWD, path, 0);
    if (!done) put('U', name, 0, NULL, 0);
    pthread_mutex_unlock(&turn);
    return done;
}
int unlink(const char *path) { return removed(path); }
