/* RCB/1, the robot's side: frames in, buttons and frames out; plain C99 without allocation or hardware.
 *
 * Feed every byte that arrives to rcb_receive, call rcb_tick at least every 10 ms, copy rcb_buttons to the
 * pins and the bytes of rcb_transmit to the wire. Times are a free-running count of milliseconds that may
 * wrap. README.md in this folder describes the bytes and the rules. */

#ifndef RCB_H
#define RCB_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { RCB_MAJOR = 1, RCB_MINOR = 0 };
enum { RCB_HELLO = 0x01, RCB_COMMAND = 0x02, RCB_STOP = 0x03, RCB_HELLO_ACK = 0x81, RCB_STATUS = 0x82 };
enum { RCB_WAITING = 0, RCB_NEUTRAL = 1, RCB_DRIVING = 2, RCB_TRIPPED = 3 };
enum { RCB_FORWARD = 1, RCB_BACKWARD = 2, RCB_LEFT = 4, RCB_RIGHT = 8 };

enum {
    RCB_DECODED_MAX = 32,
    RCB_ENCODED_MAX = RCB_DECODED_MAX + 1,
    RCB_TIME_TO_LIVE_MAX = 15,  /* in 10 ms */
    RCB_SEQUENCE_STEP_MAX = 16, /* commands that can be lost in a row before the longest life is over, at 100 Hz */
    RCB_STATUS_PERIOD = 100,    /* ms */
    RCB_LEAK_PERIOD = 128,      /* ms after which a transit 1 ms longer is the shortest: clocks 0.8 % apart */
    RCB_OUTPUT_SIZE = 96
};

/* A command as it was sent; buttons without their complement, time_to_live in 10 ms. */
struct rcb_command {
    uint16_t session, sequence, host_ms;
    uint8_t buttons, time_to_live;
};

typedef struct rcb_core {
    uint32_t nonce, deadline, status_at, leak_at;
    uint32_t accepted; /* commands, since the start */
    struct rcb_command command; /* the last accepted one */
    uint16_t firmware_build, boot_count, session, last_sequence;
    uint16_t offset; /* ms: the smallest robot clock minus host clock of this session */
    uint16_t crc, length, duplicate, late, trips;
    uint8_t reset_cause, state, buttons;
    uint8_t overlong, received; /* bytes of the incoming frame */
    uint8_t out_begin, out_end;
    uint8_t in[RCB_ENCODED_MAX];
    uint8_t out[RCB_OUTPUT_SIZE];
} rcb_core;

/* Start with all buttons open, waiting for a HELLO. */
void rcb_init(rcb_core *core, uint16_t firmware_build, uint8_t reset_cause, uint16_t boot_count);

/* Take in one byte from the wire. */
void rcb_receive(rcb_core *core, uint8_t byte, uint32_t now_ms);

/* Let time pass: open the buttons if the last command has outlived its time to live, report at 10 Hz. */
void rcb_tick(rcb_core *core, uint32_t now_ms);

/* The buttons to close: never forward and backward, never left and right together. */
uint8_t rcb_buttons(const rcb_core *core);

/* The number of commands accepted since the start. */
uint32_t rcb_accepted(const rcb_core *core);

/* Move up to capacity bytes for the wire to out and return their number. */
size_t rcb_transmit(rcb_core *core, uint8_t *out, size_t capacity);

/* The size of rcb_core in bytes, for callers in other languages. */
size_t rcb_size(void);

/* CRC-16/CCITT-FALSE. */
uint16_t rcb_crc(const uint8_t *data, size_t length);

/* Write COBS(body, CRC) and the delimiter to out, which has length + 4 bytes; return the number written. */
size_t rcb_encode(const uint8_t *body, size_t length, uint8_t *out);

#ifdef __cplusplus
}
#endif

#endif
