/*
 * ptrace for a kernel in user mode, on processors whose XSAVE area is larger than that kernel knows.
 *
 * user-mode Linux reads and writes a process's floating-point registers by PTRACE_GETREGSET and PTRACE_SETREGSET of
 * NT_X86_XSTATE, with a buffer of 2696 bytes. On a processor with AMX the area has 11,008 bytes, and the host accepts
 * only a whole area (arch/x86/kernel/fpu/regset.c, xstateregs_set: EFAULT otherwise): "ptrace set fp regs failed,
 * errno = 14". Loaded before the C library, this function reads the whole area, and on a write replaces its beginning
 * and writes the whole back. All other requests are passed on unchanged.
 *
 * Built and used by test_guest.py.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <sys/uio.h>

typedef long (*ptrace_function)(enum __ptrace_request, ...);

/* Not on the stack: that of a kernel in user mode is short. One thread traces. */
static char area[65536] __attribute__((aligned(64)));

static long exchange(ptrace_function next, enum __ptrace_request request, pid_t pid, void *set, struct iovec *asked)
{
    struct iovec whole = { area, sizeof area };
    long done = next(PTRACE_GETREGSET, pid, set, &whole);
    if (done < 0)
        return done;
    size_t length = asked->iov_len < whole.iov_len ? asked->iov_len : whole.iov_len;
    if (request == PTRACE_GETREGSET) {
        memcpy(asked->iov_base, area, length);
        asked->iov_len = length;
        return done;
    }
    memcpy(area, asked->iov_base, length);
    return next(PTRACE_SETREGSET, pid, set, &whole);
}

long ptrace(enum __ptrace_request request, ...)
{
    static ptrace_function next;
    va_list list;
    va_start(list, request);
    pid_t pid = va_arg(list, pid_t);
    void *address = va_arg(list, void *);
    void *data = va_arg(list, void *);
    va_end(list);
    if (!next)
        next = (ptrace_function)dlsym(RTLD_NEXT, "ptrace");
    if ((request == PTRACE_GETREGSET || request == PTRACE_SETREGSET) && (long)address == NT_X86_XSTATE)
        return exchange(next, request, pid, address, data);
    return next(request, pid, address, data);
}
