// A 32-bit board (Teensy, RP2040, ESP32) with a quadrature encoder on two interrupt pins, and a motor driver with a PWM
// pin and a direction pin. Each count keeps its time, so that slow motion is not lost.

#ifndef IRAM_ATTR
#define IRAM_ATTR  // only an ESP32 needs interrupt handlers in RAM
#endif

const uint16_t PERIOD_US = 1000;         // of the states: 1 kHz
const uint16_t WATCHDOG_MS = 20;         // the force ends after this time without a command
const uint32_t LIMIT_uN = 3000000;       // the maximum force that the motor makes
const uint32_t CONTINUOUS_uN = 1000000;  // the force that it can hold continuously; 0: not known
const uint32_t REACH_um = 40000;         // of the handle from its centre, in both directions
const uint32_t COUNT_nm = 15000;         // motion of the handle in one count, four counts per line
const uint32_t NOISE_nm = COUNT_nm / 4;  // counts are uneven: spread between early and late counts
const bool ABSOLUTE = false;             // true: an encoder with an absolute position at power-on
const uint8_t BUTTONS = 1;               // number of buttons, 4 at most
const int8_t DEAD_MAN = 0;               // which of them must be held; -1: none

const int PIN_PWM = 5, PIN_DIRECTION = 8, PIN_A = 2, PIN_B = 3, PIN_BUTTON = 4;
const float PWM_AT_LIMIT = 255.0f;       // measure it: hang a weight on the handle

volatile int32_t counts = 0;
volatile uint32_t counted_at_us = 0;
volatile int8_t counted_by = 0;

void IRAM_ATTR on_encoder() {
  static const int8_t STEP[16] = {0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0};
  static uint8_t phases = 0;
  phases = (phases << 2 | digitalRead(PIN_A) << 1 | digitalRead(PIN_B)) & 15;
  int8_t step = STEP[phases];
  if (step == 0) return;
  counts = counts + step;
  counted_by = step;
  counted_at_us = micros();
}

uint32_t clock_us() { return micros(); }

void prepare() {
  pinMode(PIN_PWM, OUTPUT);
  pinMode(PIN_DIRECTION, OUTPUT);
  pinMode(PIN_A, INPUT_PULLUP);
  pinMode(PIN_B, INPUT_PULLUP);
  pinMode(PIN_BUTTON, INPUT_PULLUP);
#if defined(ARDUINO_ARCH_RP2040)
  analogWriteFreq(20000);  // above the audible range
#elif defined(ARDUINO_ARCH_ESP32) || defined(TEENSYDUINO)
  analogWriteFrequency(PIN_PWM, 20000);
#endif
  on_encoder();
  attachInterrupt(digitalPinToInterrupt(PIN_A), on_encoder, CHANGE);
  attachInterrupt(digitalPinToInterrupt(PIN_B), on_encoder, CHANGE);
}

void run() {}  // called as often as it can be

// Position of the handle [nm], its time, and the direction of the last count: 1 or -1; 0: sampled at that time.
int32_t position_nm(uint32_t *at_us, int8_t *by) {
  noInterrupts();
  int32_t now = counts;
  *at_us = counted_at_us;
  *by = counted_by;
  interrupts();
  return now * (int32_t)COUNT_nm;
}

void zero() {
  noInterrupts();
  counts = 0;
  interrupts();
}

// Hold a force, in 32767ths of LIMIT_uN; returns the force after rounding to steps of the PWM.
int16_t set_force(int16_t force) {
  const float STEP = 32767.0f / PWM_AT_LIMIT;
  int duty = (int)(abs((int)force) / STEP + 0.5f);
  digitalWrite(PIN_DIRECTION, force < 0 ? HIGH : LOW);
  analogWrite(PIN_PWM, duty);
  return (int16_t)((force < 0 ? -duty : duty) * STEP);
}

uint8_t buttons() { return digitalRead(PIN_BUTTON) == LOW ? 1 : 0; }
