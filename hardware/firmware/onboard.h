/* A controller on the board: what `sysid-evo export --to c --name controller` wrote decides on the buttons.
 *
 * The host still holds the dead man's switch: the controller drives only while commands of the host count, whatever
 * buttons they name. The board's own file gives onboard_observe. */

#ifndef ONBOARD_H
#define ONBOARD_H

#include "rcb.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Wait for the host; the controller has seen nothing yet. */
void onboard_init(void);

/* The buttons to close at this time: those of the newest decision, none unless the core drives.
 *
 * Call it at least every few ms; the controller decides once every CONTROLLER_DT. */
uint8_t onboard_buttons(const rcb_core *core, uint32_t now_ms);

/* Write what the controller is shown, in the order of its file, to the n numbers; return 0 if the robot is not seen.
 *
 * float or double as the controller was written: ONBOARD_REAL. */
#ifndef ONBOARD_REAL
#define ONBOARD_REAL float
#endif
uint8_t onboard_observe(ONBOARD_REAL *observation, size_t n, uint32_t now_ms);

#ifdef __cplusplus
}
#endif

#endif
