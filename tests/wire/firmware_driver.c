/* Encodes one sample per input line with deploy/firmware/magcal_encode.h and prints the frame in hex, "-" if refused.
 * A line: M|V|S frame_sequence craft source sequence time_ns clock axes a b c; numbers as the hex of their doubles. */
#include "magcal_encode.h"

#include <inttypes.h>
#include <stdio.h>

static magcal_real real_of(uint64_t bits) {
    double value;
    memcpy(&value, &bits, sizeof value);
    return (magcal_real)value;
}

int main(void) {
    char form, craft[64], source[64];
    uint16_t frame_sequence;
    uint32_t sequence;
    int64_t time_ns;
    int clock, axes;
    uint64_t bits[3];
    while (scanf(" %c %" SCNu16 " %63s %63s %" SCNu32 " %" SCNd64 " %d %d %" SCNx64 " %" SCNx64 " %" SCNx64, &form,
                 &frame_sequence, craft, source, &sequence, &time_ns, &clock, &axes, &bits[0], &bits[1],
                 &bits[2]) == 11) {
        uint8_t frame[MAGCAL_FRAME_BYTES];
        magcal_real values[3];
        magcal_origin origin;
        size_t size, i;
        for (i = 0; i < 3; i++) values[i] = real_of(bits[i]);
        origin.craft = craft;
        origin.source = source;
        origin.sequence = sequence;
        origin.time_ns = time_ns;
        origin.clock = clock;
        if (form == 'M') {
            size = magcal_magnetometer(frame, frame_sequence, &origin, values);
        } else if (form == 'V') {
            size = magcal_reference_vector(frame, frame_sequence, &origin, values, axes);
        } else {
            size = magcal_reference_magnitude(frame, frame_sequence, &origin, values[0]);
        }
        if (size == 0) printf("-");
        for (i = 0; i < size; i++) printf("%02x", frame[i]);
        printf("\n");
    }
    return 0;
}
