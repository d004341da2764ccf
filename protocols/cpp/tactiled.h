/* C interface of the client of tactiled, for any language that can call C: libtactiled.
 *
 *     tactiled_client *events = tactiled_open("tcp://127.0.0.1:9872", "slip", NULL, NULL);
 *     while (events && (kind = tactiled_next(events, -1.0)) >= 0)
 *         if (kind == TACTILED_MESSAGE && tactiled_number(events, "valid", &is_valid) == 0 && is_valid &&
 *             tactiled_is_fresh(events) && fabs(tactiled_age_s(events)) < 0.2 && (what = tactiled_text(events, "kind")))
 *             puts(what);
 *
 * The rules are those of tactiled.hpp; docs/native.md says how to build and use it. Use a client from one
 * thread at a time; only `tactiled_close` takes a NULL for it. What a client returns by pointer is valid until the
 * next call with this client. Texts are UTF-8. Where a function fails, `tactiled_error` has the reason. */
#ifndef TACTILED_H
#define TACTILED_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A client of one daemon, which receives items and sends commands. */
typedef struct tactiled_client tactiled_client;

/* What `tactiled_next` returns. */
enum tactiled_kind {
    TACTILED_FAILED = -1,   /* `tactiled_error` says why */
    TACTILED_NONE = 0,      /* nothing came in time */
    TACTILED_MESSAGE = 1,   /* a message, in the order of its topic */
    TACTILED_RECOVERED = 2, /* a message that was missed and requested again: it is old */
    TACTILED_LOST = 3,      /* `tactiled_count` messages of `tactiled_topic` cannot be recovered */
    TACTILED_RESTARTED = 4, /* the daemon was restarted */
    TACTILED_STALE = 5,     /* do not act on data until TACTILED_FRESH; `tactiled_reason` says why */
    TACTILED_FRESH = 6,     /* the board runs, and arriving data are new */
    TACTILED_MALFORMED = 7  /* received data that are no message of tactiled */
};

/* Why a call of this thread failed, the newest that did; empty before any. Valid until the next call. */
const char *tactiled_error(void);

/* Begin to receive from a daemon; NULL where the endpoint, a topic or a file is wrong. A daemon that is not
 * there shows as TACTILED_STALE. `topics`: separated by blanks, "slip grip"; NULL for all. `board`: serial
 * number; NULL for all. `keys`: file of `tactiled keys make`; NULL without keys. */
tactiled_client *tactiled_open(const char *endpoint, const char *topics, const char *board, const char *keys);

/* End a client and free its memory; a NULL is passed over. */
void tactiled_close(tactiled_client *client);

/* Take the next item, and wait for it for at most `wait_s`: 0 does not wait, a negative one waits for ever.
 * Returns an enum tactiled_kind; a signal ends the wait, too, with TACTILED_NONE. */
int tactiled_next(tactiled_client *client, double wait_s);

/* Descriptor for poll or an event loop. When it is readable, call `tactiled_next(client, 0)` until it returns
 * TACTILED_NONE: only then does it become readable again. */
int tactiled_fd(tactiled_client *client);

/* 1 while tactile data may be acted on, else 0. */
int tactiled_is_fresh(const tactiled_client *client);

/* Of the item that `tactiled_next` took last. Texts are empty, and numbers 0, where the item has none. */
const char *tactiled_topic(const tactiled_client *client);
const char *tactiled_board(const tactiled_client *client);
const char *tactiled_reason(const tactiled_client *client);
uint64_t tactiled_count(const tactiled_client *client);

/* Seconds since the evidence of the message was complete: act on a message by this age. NaN where the item is
 * no message. */
double tactiled_age_s(const tactiled_client *client);

/* Read a field of the message (protocols/events). A number, or 1 or 0 for true and false: returns 0, or -1
 * where there is no such field or it is of another type. */
int tactiled_number(tactiled_client *client, const char *field, double *value);

/* Read a field that is a list of numbers: returns how many there are, of which at most `most` are written, or -1
 * where there is no such field or it is of another type. */
long tactiled_numbers(tactiled_client *client, const char *field, double *values, size_t most);

/* Read a field that is a text; NULL where there is no such field or it is of another type. */
const char *tactiled_text(tactiled_client *client, const char *field);

/* The message as it came, a msgpack map; NULL and size 0 where the item is no message. */
const unsigned char *tactiled_payload(const tactiled_client *client, size_t *size);

/* Send a command (protocols/control.md) and wait for the reply, at most 5 s. `fields`: NAME=VALUE, one in
 * each line, as in "duration_s=0.4"; NULL for none. A value that is a finite number is sent as one, `true`
 * and `false` as such, all others as text; one in double quotes is text, whatever it looks like. The board of
 * `tactiled_open` is added. Returns 0 where the command was carried out, 1 where it was refused, -1 without a
 * reply: it may have been carried out all the same. */
int tactiled_command(tactiled_client *client, const char *command, const char *fields);

#ifdef __cplusplus
}
#endif

#endif
