/* A controller on the board: the file of `sysid-evo export --to c --name controller` decides on the buttons.
 *
 * The host keeps the dead-man function: the controller drives only while commands of the host are accepted,
 * whatever their buttons. The board's own file defines onboard_observe. */

#ifndef ONBOARD_H
#define ONBOARD_H

#include "rcb.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Wait for the host; the controller has no observations yet. */
void onboard_init(void);

/* The buttons to close at this time: those of the newest decision, none unless the core drives.
 *
 * Call it at least every few ms; the controller decides once every CONTROLLER_DT. */
uint8_t onboard_buttons(const rcb_core *core, uint32_t now_ms);

/* Write the controller's observations, in the order of its file, to the n numbers; return 0 without a pose.
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
