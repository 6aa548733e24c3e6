// A serial axis for hapnet: the protocol of hapnet/devices/serial_axis.md, version 1.
//
// Fill in the four functions at the top for your board. They are written for a Hapkit-like one: a motor on a driver with
// a PWM pin and a direction pin, a quadrature encoder on two interrupt pins, a capstan between motor and handle.
// The loop keeps 1 kHz by itself, ends the force when no command comes, and counts the motor's impulse.

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const uint32_t PERIOD_US = 1000;      // of the states: 1 kHz
const uint32_t WATCHDOG_MS = 20;      // no command for so long: no force
const int32_t LIMIT_mN = 3000;        // the longest force that the motor makes
const int32_t CONTINUOUS_mN = 1000;   // the one that it makes for ever; 0: not known
const int32_t REACH_um = 40000;       // of the handle from its centre, either way
const int32_t COUNT_nm = 15000;       // the handle moves by so much in one count of the encoder
const int BUTTONS = 1, DEAD_MAN = 0;  // how many; which one must be held, -1: none

const int PIN_PWM = 5, PIN_DIRECTION = 8, PIN_A = 2, PIN_B = 3, PIN_BUTTON = 4;
const float PWM_PER_N = 85.0f;        // measure it: hang a weight on the handle

volatile int32_t counts = 0;
bool homed = false;

void on_encoder() { counts += (digitalRead(PIN_A) == digitalRead(PIN_B)) ? 1 : -1; }

int32_t position_nm() {
  noInterrupts();
  int32_t now = counts;
  interrupts();
  return now * COUNT_nm;
}

void set_force_uN(int32_t force) {
  digitalWrite(PIN_DIRECTION, force < 0);
  analogWrite(PIN_PWM, min(255, (int)(abs(force) * 1e-6f * PWM_PER_N)));
}

uint8_t buttons() { return digitalRead(PIN_BUTTON) == LOW ? 1 : 0; }

// -- below this line nothing depends on the board --------------------------------------------------------------------

int32_t force_uN = 0;        // acts now
uint32_t impulse_nNs = 0;    // its integral, modulo 2^32
uint32_t counted_us = 0;     // up to when it was counted
uint32_t command_ms = 0;     // when the last command came
uint16_t sequence = 0;
char line[64];
uint8_t length = 0;

uint16_t crc16(const char *data, size_t count) {
  uint16_t crc = 0xFFFF;
  while (count--) {
    crc ^= (uint16_t)(uint8_t)*data++ << 8;
    for (int bit = 0; bit < 8; bit++) crc = crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1;
  }
  return crc;
}

void send(char *body) {
  char end[8];
  snprintf(end, sizeof end, "*%04X\n", crc16(body, strlen(body)));
  Serial.print(body);
  Serial.print(end);
}

void count_impulse() {
  uint32_t now_us = micros();
  impulse_nNs += (int32_t)((int64_t)force_uN * (int32_t)(now_us - counted_us) / 1000);
  counted_us = now_us;
}

void act(int32_t wanted_uN) {
  count_impulse();
  const int32_t most_uN = LIMIT_mN * 1000;
  force_uN = wanted_uN > most_uN ? most_uN : wanted_uN < -most_uN ? -most_uN : wanted_uN;
  set_force_uN(force_uN);
}

void answer() {
  char body[96];
  snprintf(body, sizeof body, "I 1 %ld %ld %ld %ld %ld %ld %d %d %d", 1000000L / (long)PERIOD_US, (long)LIMIT_mN,
           (long)CONTINUOUS_mN, (long)COUNT_nm, (long)REACH_um, (long)WATCHDOG_MS, homed ? 1 : 0, BUTTONS, DEAD_MAN);
  send(body);
}

void on_line() {
  char *star = strrchr(line, '*');
  if (!star || strlen(star) != 5) return;
  if (strtoul(star + 1, 0, 16) != crc16(line, star - line)) return;
  *star = 0;
  if (line[0] == 'F') {
    char *rest;
    sequence = (uint16_t)strtoul(line + 1, &rest, 10);
    act(strtol(rest, 0, 10));
    command_ms = millis();
  } else if (line[0] == 'I') {
    answer();
  } else if (line[0] == 'H') {
    noInterrupts();
    counts = 0;
    interrupts();
    homed = true;
  }
}

void listen() {
  while (Serial.available()) {
    char c = Serial.read();
    if (c == '\n') {
      line[length] = 0;
      on_line();
      length = 0;
    } else if (length < sizeof line - 1) {
      line[length++] = c;
    } else {
      length = 0;  // too long to be ours
    }
  }
}

void setup() {
  pinMode(PIN_PWM, OUTPUT);
  pinMode(PIN_DIRECTION, OUTPUT);
  pinMode(PIN_A, INPUT_PULLUP);
  pinMode(PIN_B, INPUT_PULLUP);
  pinMode(PIN_BUTTON, INPUT_PULLUP);
  attachInterrupt(digitalPinToInterrupt(PIN_A), on_encoder, CHANGE);
  set_force_uN(0);
  Serial.begin(1000000);
  counted_us = micros();
}

void loop() {
  static uint32_t due_us = micros();
  static int32_t before_nm = 0, velocity_um_s = 0;
  listen();
  if (force_uN != 0 && millis() - command_ms >= WATCHDOG_MS) act(0);
  if ((int32_t)(micros() - due_us) < 0) return;
  due_us += PERIOD_US;
  int32_t now_nm = position_nm();
  int32_t raw_um_s = (now_nm - before_nm) / (int32_t)PERIOD_US * 1000;
  velocity_um_s += (raw_um_s - velocity_um_s) / 4;  // one count a period is much: a low pass of 4 ms
  before_nm = now_nm;
  count_impulse();
  char body[96];
  snprintf(body, sizeof body, "S %lu %ld %ld %lu %u %u", (unsigned long)counted_us, (long)now_nm, (long)velocity_um_s,
           (unsigned long)impulse_nNs, (unsigned)sequence, (unsigned)buttons());
  send(body);
}
