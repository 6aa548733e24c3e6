// A Hapkit: ATmega328P at 16 MHz, an analogue magnetic sensor (KMA210) at A2, a motor driver with PWM at pin 5 and the
// direction at pin 8. 500 Hz. Positions count from the position at power-on: centre the handle, and use home=yes.
//
// PWM: pin 5 belongs to timer 0, here at 62.5 kHz as in Hapkit's own programs. Arduino's micros(), millis() and delay()
// then go 64 times too fast, and the timer's interrupt takes a third of the processor. So it is off, and timer 1 is the clock.

const uint16_t PERIOD_US = 2000;         // of the states: 500 Hz
const uint16_t WATCHDOG_MS = 20;         // the force ends after this time without a command
const uint32_t LIMIT_uN = 3000000;       // the maximum force that the motor makes
const uint32_t CONTINUOUS_uN = 0;        // the force that it can hold continuously; 0: not known
const uint32_t REACH_um = 50000;         // of the handle from its centre, in both directions
const bool ABSOLUTE = false;
const uint8_t BUTTONS = 0;               // number of buttons, 4 at most
const int8_t DEAD_MAN = -1;              // which of them must be held; -1: none

// Measure these three on yours.
const float HANDLE_mm = 65.7f, SECTOR_mm = 73.2f, PULLEY_mm = 4.19f;  // radii: of the handle, the sector, the motor's pulley
const int16_t HALF_TURN = 920;           // readings of the sensor from one jump to the next, half a turn of the magnet
const float FULL_TORQUE_Nm = 0.03f;      // of the motor at a duty of 1; it grows with the square of the duty, as Hapkit's pages say

const float READING_nm = 3.14159265f / HALF_TURN * HANDLE_mm / SECTOR_mm * PULLEY_mm * 1e6f;
const uint32_t COUNT_nm = (uint32_t)READING_nm;
const uint32_t NOISE_nm = 2 * COUNT_nm;  // of its readings, from peak to peak: the doctor shows it
const float DUTY_AT_LIMIT_2 = LIMIT_uN * 1e-9f * HANDLE_mm / SECTOR_mm * PULLEY_mm / FULL_TORQUE_Nm;

const uint8_t PIN_PWM = 5, PIN_DIRECTION = 8, CHANNEL = 2;
const uint8_t TOGETHER = 4;              // readings for a state: their mean is finer than one reading
const int16_t FURTHEST = 100;            // largest plausible motion between two readings: beyond it the sensor was in its jump

int32_t place = 0;                       // in readings, over all half turns
int32_t summed = 0, centre = 0;          // TOGETHER of them, now and at the centre
int16_t before = 0;

uint32_t clock_us() {  // timer 1 counts half microseconds; call it at least every 32 ms
  static uint16_t asked = 0;
  static uint32_t now_us = 0;
  uint16_t halves = (TCNT1 - asked) & 0xFFFE;
  asked += halves;
  return now_us += halves >> 1;
}

int16_t reading() {
  ADCSRA |= _BV(ADSC);
  while (ADCSRA & _BV(ADSC)) {}
  return ADC;
}

void prepare() {
  pinMode(PIN_PWM, OUTPUT);
  pinMode(PIN_DIRECTION, OUTPUT);
  TIMSK0 = 0;
  TCCR0B = (TCCR0B & 0xF8) | _BV(CS00);                // 62.5 kHz
  TCCR1A = 0;
  TCCR1B = _BV(CS11);                                  // 2 MHz
  ADMUX = _BV(REFS0) | CHANNEL;
  ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1);        // 250 kHz: 52 us a reading
  before = reading();
}

void run() {}  // called as often as it can be

int32_t position_nm(uint32_t *at_us, int8_t *by) {
  static uint8_t jumps = 0;
  summed = 0;
  uint32_t start_us = clock_us();
  for (uint8_t k = 0; k < TOGETHER; k++) {
    int16_t now = reading(), by_now = now - before;
    if (by_now > HALF_TURN / 2) by_now -= HALF_TURN;
    if (by_now < -HALF_TURN / 2) by_now += HALF_TURN;
    if (abs(by_now) <= FURTHEST || ++jumps > TOGETHER) {
      place += by_now;
      before = now;
      jumps = 0;
    }
    summed += place;
  }
  *at_us = start_us + (clock_us() - start_us) / 2;
  *by = 0;
  return (int32_t)((summed - centre) * (READING_nm / TOGETHER));
}

void zero() { centre = summed; }

// Hold a force, in 32767ths of LIMIT_uN; returns the force after rounding to steps of the PWM.
int16_t set_force(int16_t force) {
  const float SHARE = DUTY_AT_LIMIT_2 * 255.0f * 255.0f / 32767.0f;  // of a duty's square in a 32767th
  float duty = sqrt(fabs((float)force) * SHARE);
  uint8_t whole = duty < 255.0f ? (uint8_t)duty : 255;
  digitalWrite(PIN_DIRECTION, force < 0 ? HIGH : LOW);
  analogWrite(PIN_PWM, whole);
  int16_t made = (int16_t)((uint16_t)whole * whole * (1.0f / SHARE));
  return force < 0 ? -made : made;
}

uint8_t buttons() { return 0; }
