/* See onboard.h. The controller's file is included, so that it need not be declared twice. */

#include "onboard.h"

#ifndef CONTROLLER_FILE
#define CONTROLLER_FILE "controller.c"
#endif
#include CONTROLLER_FILE

enum { DRIVE, STEER }; /* controls of the car, each -1, 0 or 1 */

typedef char expected_drive_and_steer[CONTROLLER_CONTROLS == 2 ? 1 : -1];

static controller_memory memory;
static uint32_t due_at;
static uint8_t driving, decided;

void onboard_init(void) {
    driving = 0;
    decided = 0;
}

static uint8_t buttons_of(const controller_real *control) {
    uint8_t buttons = 0;
    if (control[DRIVE] > (controller_real)0.5) {
        buttons = RCB_FORWARD;
    } else if (control[DRIVE] < (controller_real)-0.5) {
        buttons = RCB_BACKWARD;
    }
    if (control[STEER] > (controller_real)0.5) {
        return (uint8_t)(buttons | RCB_LEFT);
    }
    if (control[STEER] < (controller_real)-0.5) {
        return (uint8_t)(buttons | RCB_RIGHT);
    }
    return buttons;
}

uint8_t onboard_buttons(const rcb_core *core, uint32_t now_ms) {
    uint32_t const period = (uint32_t)(CONTROLLER_DT * 1000.0 + 0.5);
    if (core->state != RCB_DRIVING) {
        driving = 0;
        return 0;
    }
    if (!driving) { /* another run, without memory of the last one */
        controller_reset(&memory);
        driving = 1;
        due_at = now_ms;
    }
    if ((int32_t)(now_ms - due_at) >= 0) {
        controller_real observation[CONTROLLER_OBSERVATIONS], control[CONTROLLER_CONTROLS];
        due_at += period;
        if ((int32_t)(now_ms - due_at) >= 0) { /* late by a sample or more: it is skipped, not caught up */
            due_at = now_ms + period;
        }
        decided = 0;
        if (onboard_observe(observation, CONTROLLER_OBSERVATIONS, now_ms)) {
            controller_step(&memory, observation, control);
            decided = buttons_of(control);
        }
    }
    return decided;
}
