/* magcal.h: the whole kit: encode, seal, decode, apply.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef MAGCAL_H
#define MAGCAL_H

#include "magcal_apply.h"
#include "magcal_decode.h"
#include "magcal_encode.h"
#include "magcal_seal.h"

#endif
