/* Feeds streams from stdin to fresh cores and writes what each says, for runs under sanitizers.
 *
 * A stream is u32 length, then that many bytes: chunks of u8 milliseconds to wait, u8 length, bytes. The reply is
 * u32 length, then what the core transmitted. Stops with an error if two buttons that exclude each other close. */

#include <stdio.h>
#include <stdlib.h>

#include "rcb.h"

static uint8_t *spoken;
static size_t spoken_size, spoken_room;

static void take_output(rcb_core *core) {
    for (;;) {
        if (spoken_room - spoken_size < RCB_OUTPUT_SIZE) {
            spoken_room = 2 * spoken_room + RCB_OUTPUT_SIZE;
            spoken = realloc(spoken, spoken_room);
        }
        size_t const moved = rcb_transmit(core, spoken + spoken_size, 7);
        if (moved == 0) {
            return;
        }
        spoken_size += moved;
    }
}

static void check(const rcb_core *core) {
    uint8_t const buttons = rcb_buttons(core);
    if (buttons > 15 || (buttons & 3) == 3 || (buttons & 12) == 12) {
        fprintf(stderr, "illegal buttons %u\n", buttons);
        exit(3);
    }
}

static void replay(const uint8_t *stream, size_t size) {
    rcb_core *const core = malloc(rcb_size());
    uint32_t now = 0;
    rcb_init(core, 1, 1, 1);
    for (size_t at = 0; at + 1 < size;) {
        size_t const end = at + 2 + stream[at + 1];
        now += stream[at];
        for (at += 2; at < end && at < size; at++) {
            rcb_receive(core, stream[at], now);
            check(core);
        }
        take_output(core);
    }
    rcb_tick(core, now + RCB_STATUS_PERIOD + 10 * RCB_TIME_TO_LIVE_MAX);
    check(core);
    take_output(core);
    free(core);
}

int main(void) {
    uint32_t size;
    while (fread(&size, sizeof size, 1, stdin) == 1) {
        uint8_t *const stream = malloc(size);
        if (fread(stream, 1, size, stdin) != size) {
            return 2;
        }
        spoken_size = 0;
        replay(stream, size);
        free(stream);
        uint32_t const reply = (uint32_t)spoken_size;
        fwrite(&reply, sizeof reply, 1, stdout);
        fwrite(spoken, 1, spoken_size, stdout);
        fflush(stdout);
    }
    free(spoken);
    return 0;
}
