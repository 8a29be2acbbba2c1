/* magcal_apply.h: the nine errors put to use on the board.
 *
 *     w = (I + D) B - b
 *
 * with B the measured and w the calibrated vector [nT], both in the sensor's own axes, b the bias [nT] and D symmetric,
 * D11, D22, D33, D12, D13, D23 in this order: the equation and the order of all of magcal.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef MAGCAL_APPLY_H
#define MAGCAL_APPLY_H

#include "magcal_decode.h"

#ifdef __cplusplus
extern "C" {
#endif

/* `field_nt` and `calibrated_nt` may be the same array. */
static inline void magcal_apply(const magcal_real bias_nt[3], const magcal_real D[6], const magcal_real field_nt[3],
                                magcal_real calibrated_nt[3]) {
    const magcal_real x = field_nt[0], y = field_nt[1], z = field_nt[2];
    calibrated_nt[0] = x + D[0] * x + D[3] * y + D[4] * z - bias_nt[0];
    calibrated_nt[1] = y + D[3] * x + D[1] * y + D[5] * z - bias_nt[1];
    calibrated_nt[2] = z + D[4] * x + D[5] * y + D[2] * z - bias_nt[2];
}

/* Whether to steer by it: trusted, and not off by more than `limit_nt` by what would not have been seen yet. */
static inline int magcal_usable(int verdict, const magcal_protection *protection, magcal_real limit_nt) {
    return verdict == MAGCAL_VERDICT_TRUSTED && protection->known && protection->nt <= limit_nt;
}

#ifdef __cplusplus
}
#endif

#endif
