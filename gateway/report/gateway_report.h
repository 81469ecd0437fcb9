/* Report test results of your own process to a gateway of this machine (AUTOSAR Dem_SetEventStatus).
 *
 *     #define _POSIX_C_SOURCE 200809L  (before any header, with -std=c99)
 *     #include "gateway_report.h"
 *
 *     gateway_reporter reporter;
 *     gateway_report_open(&reporter, "/run/gateway/report.sock", 100);
 *     gateway_report(&reporter, "battery.hot", GATEWAY_FAILED, "\"temperature\": 81.5");
 *     gateway_report_close(&reporter);
 *
 * C99 and POSIX sockets. Nothing is allocated, no signal is raised, no call takes longer than its patience. One
 * reporter for each thread. docs/report.md has the protocol.
 */
#ifndef GATEWAY_REPORT_H
#define GATEWAY_REPORT_H

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Longest report and longest answer, a packet each [byte]. */
#define GATEWAY_REPORT_MOST 4096

typedef enum {
    GATEWAY_PASSED,     /* qualifies without debounce */
    GATEWAY_FAILED,     /* qualifies without debounce */
    GATEWAY_PREPASSED,  /* is debounced by the gateway */
    GATEWAY_PREFAILED,  /* is debounced by the gateway */
    GATEWAY_NOT_TESTED  /* the test cannot run at present */
} gateway_result;

typedef enum {
    GATEWAY_ACCEPTED = 0,
    GATEWAY_REFUSED = 1,     /* reporter.refused says why */
    GATEWAY_UNDELIVERED = 2, /* the gateway was not reached */
    GATEWAY_UNANSWERED = 3   /* it has left, and the answer did not come in time */
} gateway_outcome;

typedef struct {
    int fd;          /* -1: not connected */
    int patience_ms; /* longest time of a call */
    unsigned long number;
    unsigned long accepted, denied, undelivered, unanswered;
    char refused[32]; /* word of docs/report.md of the latest refusal */
    struct sockaddr_un address;
} gateway_reporter;

/* Prepare a reporter; the connection is made when it is needed, and again when the gateway has started again.
 * Returns 0, or -1 if the path is too long. */
static inline int gateway_report_open(gateway_reporter *r, const char *path, int patience_ms)
{
    memset(r, 0, sizeof *r);
    r->fd = -1;
    r->patience_ms = patience_ms;
    r->address.sun_family = AF_UNIX;
    if (strlen(path) >= sizeof r->address.sun_path)
        return -1;
    memcpy(r->address.sun_path, path, strlen(path) + 1);
    return 0;
}

static inline long gateway_report_now_ms_(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (long)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static inline void gateway_report_drop_(gateway_reporter *r)
{
    if (r->fd >= 0)
        close(r->fd);
    r->fd = -1;
}

static inline int gateway_report_connect_(gateway_reporter *r)
{
    int flags;
    if (r->fd >= 0)
        return 0;
    r->fd = socket(AF_UNIX, SOCK_SEQPACKET, 0);
    if (r->fd < 0)
        return -1;
    flags = fcntl(r->fd, F_GETFL, 0);
    if (flags < 0 || fcntl(r->fd, F_SETFL, flags | O_NONBLOCK) < 0 || fcntl(r->fd, F_SETFD, FD_CLOEXEC) < 0 ||
        connect(r->fd, (const struct sockaddr *)&r->address, sizeof r->address) < 0) {
        gateway_report_drop_(r);
        return -1;
    }
    return 0;
}

/* Wait until it can be read (POLLIN) or written (POLLOUT); returns whether it can in time. */
static inline int gateway_report_wait_(gateway_reporter *r, short what, long until_ms)
{
    struct pollfd asked;
    for (;;) {
        long left = until_ms - gateway_report_now_ms_();
        int ready;
        asked.fd = r->fd;
        asked.events = what;
        asked.revents = 0;
        ready = poll(&asked, 1, left > 0 ? (int)left : 0);
        if (ready > 0)
            return 1;
        if (ready == 0 || errno != EINTR)
            return 0;
    }
}

/* Copy the text of a key of an answer; "" if it has none. The gateway's words have no quotes and no escapes. */
static inline void gateway_report_text_(const char *answer, const char *key, char *into, size_t room)
{
    const char *found = strstr(answer, key);
    size_t length = 0;
    if (found != NULL) {
        found += strlen(key);
        length = strcspn(found, "\"");
    }
    if (length >= room)
        length = room - 1;
    if (found != NULL)
        memcpy(into, found, length);
    into[length] = '\0';
}

/* Read answers until the one with this number, or one without a number; answers to earlier reports are counted. */
static inline gateway_outcome gateway_report_answer_(gateway_reporter *r, long until_ms)
{
    char answer[GATEWAY_REPORT_MOST + 1], mine[40];
    int tries = 0;
    snprintf(mine, sizeof mine, "\"id\": \"%lu\"", r->number);
    for (;;) {
        ssize_t length;
        int accepted, numbered;
        if (!gateway_report_wait_(r, POLLIN, until_ms))
            return GATEWAY_UNANSWERED;
        length = recv(r->fd, answer, sizeof answer - 1, 0);
        if (length < 0 && (errno == EINTR || errno == EAGAIN))
            continue;
        if (length < 0 && errno == ECONNRESET && tries++ == 0)
            continue; /* it has ended with a report unread; what it said before is still there */
        if (length <= 0) {
            gateway_report_drop_(r);
            return GATEWAY_UNANSWERED;
        }
        answer[length] = '\0';
        accepted = strstr(answer, "\"ok\": true") != NULL;
        numbered = strstr(answer, "\"id\": \"") != NULL;
        if (!numbered || strstr(answer, mine) != NULL) {
            if (accepted)
                return GATEWAY_ACCEPTED;
            gateway_report_text_(answer, "\"refused\": \"", r->refused, sizeof r->refused);
            return GATEWAY_REFUSED;
        }
        r->unanswered -= r->unanswered > 0;
        if (accepted)
            r->accepted++;
        else
            r->denied++;
    }
}

static inline gateway_outcome gateway_report_send_(gateway_reporter *r, const char *packet, size_t length)
{
    const long until_ms = gateway_report_now_ms_() + r->patience_ms;
    int tries;
    for (tries = 0; tries < 2; tries++) { /* a connection to a gateway that has ended since is noticed when used */
        ssize_t sent;
        if (gateway_report_connect_(r) < 0)
            return GATEWAY_UNDELIVERED;
        if (!gateway_report_wait_(r, POLLOUT, until_ms))
            return GATEWAY_UNDELIVERED;
        sent = send(r->fd, packet, length, MSG_NOSIGNAL);
        if (sent == (ssize_t)length)
            return gateway_report_answer_(r, until_ms);
        if (errno == EAGAIN || errno == EINTR)
            return GATEWAY_UNDELIVERED;
        /* Who is not let in is told why before the connection ends. */
        if (gateway_report_wait_(r, POLLIN, gateway_report_now_ms_())) {
            gateway_outcome told = gateway_report_answer_(r, gateway_report_now_ms_());
            if (told == GATEWAY_REFUSED) {
                gateway_report_drop_(r);
                return told;
            }
        }
        gateway_report_drop_(r);
    }
    return GATEWAY_UNDELIVERED;
}

/* Report a result.
 * fault: its id, "reporter.fault", of letters, digits, '_', '-' and '.'.
 * data: NULL, or numbers in JSON by the names that the configuration gives the fault: "\"temperature\": 81.5".
 */
static inline gateway_outcome gateway_report(gateway_reporter *r, const char *fault, gateway_result result,
                                             const char *data)
{
    static const char *const words[] = {"passed", "failed", "prepassed", "prefailed", "not_tested"};
    char packet[GATEWAY_REPORT_MOST + 1];
    gateway_outcome outcome;
    int length;
    r->refused[0] = '\0';
    r->number++;
    length = snprintf(packet, sizeof packet, "{\"fault\": \"%s\", \"result\": \"%s\", \"id\": \"%lu\"%s%s%s}", fault,
                      words[result], r->number, data ? ", \"data\": {" : "", data ? data : "", data ? "}" : "");
    if (length < 0 || length > GATEWAY_REPORT_MOST) {
        strcpy(r->refused, "malformed");
        outcome = GATEWAY_REFUSED;
    } else {
        outcome = gateway_report_send_(r, packet, (size_t)length);
    }
    if (outcome == GATEWAY_ACCEPTED)
        r->accepted++;
    else if (outcome == GATEWAY_REFUSED)
        r->denied++;
    else if (outcome == GATEWAY_UNDELIVERED)
        r->undelivered++;
    else
        r->unanswered++;
    return outcome;
}

/* End the connection, and leave the faults as they are. A process that ends without it is told as lost. */
static inline void gateway_report_close(gateway_reporter *r)
{
    char packet[64];
    int length;
    if (r->fd < 0)
        return;
    r->number++;
    length = snprintf(packet, sizeof packet, "{\"goodbye\": true, \"id\": \"%lu\"}", r->number);
    (void)gateway_report_send_(r, packet, (size_t)length);
    gateway_report_drop_(r);
}

#ifdef __cplusplus
}
#endif
#endif
