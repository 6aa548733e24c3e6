// The protocol of hapnet/ext/devices/serial_axis.md, version 2, for every board: nothing to change here.
//
// It sends a state each period, holds the force of the last command, ends it when no command comes, and counts the
// motor's impulse. Frames have a fixed size and end in a CRC, high byte first, so that the CRC of a whole frame is 0.

const uint8_t VERSION = 2;
const uint8_t COUNTED = 64;  // states over which the period is measured; a power of two

struct __attribute__((packed)) State {
  uint8_t mark;          // 'S'
  uint8_t flags;         // bits 0 to 3: buttons; 4: homed; 5: the last count was up; 6: it was down
  uint16_t command;      // number of the last valid command
  uint32_t time_us;
  int32_t position_nm;
  uint16_t age_us;       // age of the position: since its last count or sample; 65535: or longer
  uint32_t impulse;      // [256 us times a 32767th of the maximum force]
  uint8_t crc[2];
};

struct __attribute__((packed)) About {
  uint8_t mark;          // 'A'
  uint8_t version;
  uint16_t period_us;    // promised
  uint16_t made_us;      // the mean of the last COUNTED; 0: not known yet
  uint16_t watchdog_ms;
  uint32_t limit_uN, continuous_uN, count_nm, noise_nm, reach_um;
  uint8_t buttons;
  int8_t dead_man;
  uint8_t crc[2];
};

struct __attribute__((packed)) Command {
  uint8_t mark;          // 'F': a force; 'Q': requests the identification; 'H': the handle is at its centre
  uint16_t number;
  int16_t force;         // in 32767ths of the maximum
  uint8_t crc[2];
};

int16_t force = 0;         // acting force
int64_t impulse = 0;       // its integral [us]
uint32_t counted_us = 0;   // time up to which it was integrated
uint32_t command_us = 0;   // when the last command came
uint16_t number = 0;
uint16_t made_us = 0;
bool homed = ABSOLUTE;

uint16_t crc16(const void *data, uint8_t count) {  // CRC-16/CCITT-FALSE
  uint16_t crc = 0xFFFF;
  for (const uint8_t *byte = (const uint8_t *)data; count--; byte++) {
    uint8_t x = (uint8_t)(crc >> 8) ^ *byte;
    x ^= x >> 4;
    crc = (uint16_t)(crc << 8 ^ (uint16_t)x << 12 ^ (uint16_t)x << 5 ^ x);
  }
  return crc;
}

void send(void *frame, uint8_t size) {
  if (Serial.availableForWrite() < size) return;  // the host does not read: never wait, the watchdog must keep running
  uint8_t *bytes = (uint8_t *)frame;
  uint16_t crc = crc16(frame, size - 2);
  bytes[size - 2] = crc >> 8;
  bytes[size - 1] = crc & 0xFF;
  Serial.write(bytes, size);
}

void count_impulse() {
  uint32_t now_us = clock_us(), since_us = now_us - counted_us;
  for (; since_us > 0x7FFF; since_us -= 0x7FFF) impulse += (int32_t)force * 0x7FFF;
  impulse += (int32_t)force * (int16_t)since_us;
  counted_us = now_us;
}

void act(int16_t wanted) {  // no force while the position is not known, as after a reset
  count_impulse();
  force = set_force(!homed ? 0 : wanted < -32767 ? -32767 : wanted);
}

void send_about() {
  About about = {'A',           VERSION,  PERIOD_US, made_us,  WATCHDOG_MS, LIMIT_uN,
                 CONTINUOUS_uN, COUNT_nm, NOISE_nm,  REACH_um, BUTTONS,     DEAD_MAN,
                 {0, 0}};
  send(&about, sizeof about);
}

void send_state() {
  uint32_t at_us;
  int8_t by;
  State state;
  state.position_nm = position_nm(&at_us, &by);
  count_impulse();
  uint32_t age_us = counted_us - at_us;
  state.mark = 'S';
  state.flags = (buttons() & 15) | (homed ? 16 : 0) | (by > 0 ? 32 : by < 0 ? 64 : 0);
  state.command = number;
  state.time_us = counted_us;
  state.age_us = age_us < 0xFFFF ? age_us : 0xFFFF;
  state.impulse = (uint32_t)(impulse >> 8);
  send(&state, sizeof state);
}

void on_command(const Command *command) {
  if (command->mark == 'F') {
    number = command->number;
    act(command->force);
    command_us = clock_us();
  } else if (command->mark == 'Q') {
    send_about();
  } else if (command->mark == 'H') {
    zero();
    homed = true;
  }
}

void listen() {
  static uint8_t frame[sizeof(Command)], length = 0;
  while (Serial.available() > 0) {
    frame[length++] = (uint8_t)Serial.read();
    if (length < sizeof frame) continue;
    if (crc16(frame, sizeof frame) == 0) {
      on_command((const Command *)frame);
      length = 0;
    } else {
      memmove(frame, frame + 1, --length);  // a byte was lost: a frame may begin at any of the others
    }
  }
}

void measure_period() {
  static uint32_t since_us = 0;
  static uint8_t states = 0;
  static bool begun = false;
  if (begun && ++states < COUNTED) return;
  uint32_t mean_us = (counted_us - since_us) / COUNTED;
  if (begun) made_us = mean_us < 0xFFFF ? mean_us : 0xFFFF;
  begun = true;
  since_us = counted_us;
  states = 0;
}

void begin_axis() {
  prepare();
  set_force(0);
  Serial.begin(1000000);
  counted_us = clock_us();
}

void run_axis() {
  static uint32_t due_us = clock_us();
  run();
  listen();
  if (force != 0 && clock_us() - command_us >= WATCHDOG_MS * 1000UL) act(0);
  uint32_t now_us = clock_us();
  if ((int32_t)(now_us - due_us) < 0) return;
  due_us = (now_us - due_us > PERIOD_US / 2 ? now_us : due_us) + PERIOD_US;  // a late state does not shorten the next period
  send_state();
  measure_period();
}
