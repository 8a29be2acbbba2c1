// magcal_board.ino: a magnetometer sample ten times a second to magcal at Serial, calibrated vectors back.
// Put the sensor's driver into read_field_nt; with a daemon whose configuration gives the reference, nothing is missing.
#define MAGCAL_SINGLE_PRECISION // most of these boards have no 64-bit floating point
#include <magcal.h>

static uint8_t held[700]; // vectors and most estimates; what is longer is counted as skipped
static magcal_decoder decoder;
static magcal_message message;
static uint16_t frame_sequence;
static uint32_t refused;
static uint32_t next_ms;
static magcal_origin origin = {"demo", "mag0", 0, 0, MAGCAL_CLOCK_ELAPSED};

static void read_field_nt(magcal_real field_body_nt[3]) {
  field_body_nt[0] = 21500.0f; // your sensor, in its own axes [nT]
  field_body_nt[1] = -13000.0f;
  field_body_nt[2] = 38250.0f;
}

static void use(const magcal_calibrated *c) {
  // Steer by c->field_body_nt here, where no unnoticed fault moves it by more than 500 nT.
  digitalWrite(LED_BUILTIN, magcal_usable(c->verdict, &c->protection, 500.0f) ? HIGH : LOW);
}

void setup() {
  Serial.begin(115200);
  pinMode(LED_BUILTIN, OUTPUT);
  magcal_decoder_begin(&decoder, held, sizeof held);
}

void loop() {
  while (Serial.available() > 0) {
    if (magcal_take(&decoder, (uint8_t)Serial.read(), &message) == MAGCAL_MESSAGE &&
        message.kind == MAGCAL_KIND_CALIBRATED) {
      use(&message.of.calibrated);
    }
  }
  const uint32_t now_ms = millis(); // wraps after 49 days: keep the high part yourself beyond that
  if ((int32_t)(now_ms - next_ms) < 0) return;
  next_ms = now_ms + 100;
  uint8_t frame[MAGCAL_FRAME_BYTES];
  magcal_real field_body_nt[3];
  origin.time_ns = (int64_t)now_ms * 1000000;
  read_field_nt(field_body_nt);
  const size_t size = magcal_magnetometer(frame, frame_sequence, &origin, field_body_nt);
  if (size == 0) {
    refused++;
    return;
  }
  Serial.write(frame, size);
  origin.sequence++;
  frame_sequence++;
}
