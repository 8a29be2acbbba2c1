/* world.h: a craft in a polar orbit, tumbling, and its magnetometer: what a real board would read from its sensor.
 *
 * The field is a dipole's; the rotations are recurrences, so that no sine is called.  The sensor's errors are known
 * here, so the board can say how far the calibrated vectors that come back are from the truth.
 */
#ifndef WORLD_H
#define WORLD_H

#include <stdint.h>

#define WORLD_PERIOD_S 0.1
#define WORLD_NOISE_NT 100.0

static const double world_bias_nt[3] = {5000.0, -3000.0, 4000.0};
static const double world_D[6] = {0.05, -0.03, 0.04, 0.01, -0.02, 0.015}; /* D11, D22, D33, D12, D13, D23 */

typedef struct {
    double cosine, sine, step_cosine, step_sine;
} world_angle;

typedef struct {
    world_angle orbit, spin, nod;
    uint32_t random;
    double field_body_nt[3];    /* the truth */
    double measured_body_nt[3]; /* what the sensor reads */
    double magnitude_nt;        /* what a field model would say */
} world;

/* The increments are the angles' cosines and sines in one period: 5580 s, 61 s and 97 s for a turn. */
static inline void world_begin(world *w) {
    static const world_angle start[3] = {{1.0, 0.0, 0.9999999936604075, 0.00011260188698749059},
                                         {1.0, 0.0, 0.9999469523400122, 0.010300121645946547},
                                         {1.0, 0.0, 0.9999790210013988, 0.006477465328666196}};
    w->orbit = start[0];
    w->spin = start[1];
    w->nod = start[2];
    w->random = 2463534242u;
}

static inline void world_turn(world_angle *a) {
    const double cosine = a->cosine * a->step_cosine - a->sine * a->step_sine;
    a->sine = a->sine * a->step_cosine + a->cosine * a->step_sine;
    a->cosine = cosine;
}

/* About normal, mean 0, sigma 1: twelve uniform numbers of a xorshift. */
static inline double world_normal(world *w) {
    double sum = -6.0;
    int i;
    for (i = 0; i < 12; i++) {
        w->random ^= w->random << 13;
        w->random ^= w->random >> 17;
        w->random ^= w->random << 5;
        sum += w->random / 4294967296.0;
    }
    return sum;
}

/* B with (I + D) B - b = H + noise, by repeated substitution: D is small. */
static inline void world_measure(world *w) {
    double aim[3], *b = w->measured_body_nt;
    int i;
    for (i = 0; i < 3; i++) {
        aim[i] = w->field_body_nt[i] + world_bias_nt[i] + WORLD_NOISE_NT * world_normal(w);
        b[i] = aim[i];
    }
    for (i = 0; i < 12; i++) {
        const double x = b[0], y = b[1], z = b[2];
        b[0] = aim[0] - world_D[0] * x - world_D[3] * y - world_D[4] * z;
        b[1] = aim[1] - world_D[3] * x - world_D[1] * y - world_D[5] * z;
        b[2] = aim[2] - world_D[4] * x - world_D[5] * y - world_D[2] * z;
    }
}

/* The next sample, one period later. */
static inline void world_step(world *w) {
    const double equator_nt = 25000.0, c = w->orbit.cosine, s = w->orbit.sine;
    const double up = -2.0 * equator_nt * s, north = equator_nt * c;
    const double x = up * c - north * s, z = up * s + north * c; /* inertial; y is 0 */
    const double tx = w->spin.cosine * x, ty = -w->spin.sine * x;
    double square;
    w->field_body_nt[0] = tx;
    w->field_body_nt[1] = w->nod.cosine * ty + w->nod.sine * z;
    w->field_body_nt[2] = w->nod.cosine * z - w->nod.sine * ty;
    square = up * up + north * north;
    { /* a square root by Newton's steps, from a start within a factor of two */
        double root = 1.5 * equator_nt;
        int i;
        for (i = 0; i < 6; i++) root = 0.5 * (root + square / root);
        w->magnitude_nt = root;
    }
    world_measure(w);
    world_turn(&w->orbit);
    world_turn(&w->spin);
    world_turn(&w->nod);
}

#endif
