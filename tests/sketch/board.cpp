// A board on this machine: what the sketch uses of Arduino, with standard input and output as its serial port, and an
// encoder on its pins whose handle is led. Built by tests/support/serial_board.py.
//
// board [SPEED [SLOW]]: the handle goes with SPEED [mm/s]; 0: to and fro by 10 mm, once a second. SLOW: so long does the
// board need for other things in each loop [us]. SIGUSR1: a reset.

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <fcntl.h>
#include <poll.h>
#include <unistd.h>

#include SKETCH

static double frozen_us = -1;  // the time of a count, while it interrupts
static int32_t led = 0;        // where the encoder stands [counts]

static double since_start_us() {
  static const auto start = std::chrono::steady_clock::now();
  return std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - start).count();
}

// the clock begins shortly before it wraps, as it does on a board after 71 minutes
uint32_t micros() {
  double now_us = frozen_us < 0 ? since_start_us() : frozen_us;
  return (uint32_t)((uint64_t)now_us + 0xFFFFFFFFull - 1500000);
}
void pinMode(int, int) {}
void digitalWrite(int, int) {}
void analogWrite(int, int) {}
int digitalRead(int pin) {  // two phases, a quarter of a line apart
  if (pin != PIN_A && pin != PIN_B) return HIGH;
  return pin == PIN_A ? (led & 3) >= 2 : (led & 3) == 1 || (led & 3) == 2;
}
int digitalPinToInterrupt(int pin) { return pin; }
void attachInterrupt(int, void (*)(), int) {}
void noInterrupts() {}
void interrupts() {}

Port Serial;
static int waiting = -1;
void Port::begin(unsigned long) {}
int Port::available() {
  unsigned char c;
  if (waiting < 0 && ::read(0, &c, 1) == 1) waiting = c;
  return waiting >= 0;
}
int Port::read() {
  int c = waiting;
  waiting = -1;
  return c;
}
int Port::availableForWrite() {
  pollfd out = {1, POLLOUT, 0};
  return poll(&out, 1, 0) == 1 ? 64 : 0;
}
size_t Port::write(const uint8_t *bytes, size_t count) {
  if (::write(1, bytes, count) < 0) _exit(0);
  return count;
}

static double speed = 0;
static double place(double at_us) {  // in counts
  double mm = speed ? speed * at_us * 1e-6 : 10 * sin(6.283185307 * at_us * 1e-6);
  return mm * 1e6 / COUNT_nm;
}

static void lead(double now_us) {
  static double before_us = 0;
  double from = place(before_us), to = place(now_us);
  while (led != (int32_t)floor(to)) {
    int step = led < floor(to) ? 1 : -1;
    double edge = led + (step > 0 ? 1 : 0), share = to == from ? 1 : (edge - from) / (to - from);
    led += step;
    frozen_us = before_us + (now_us - before_us) * fmin(1, fmax(0, share));
    on_encoder();
  }
  frozen_us = -1;
  before_us = now_us;
}

static char **self;
static void reset(int) {
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  execv(self[0], self);
}

int main(int count, char **words) {
  self = words;
  speed = count > 1 ? atof(words[1]) : 0;
  int slow_us = count > 2 ? atoi(words[2]) : 50;
  signal(SIGUSR1, reset);
  fcntl(0, F_SETFL, O_NONBLOCK);
  setup();
  while (getppid() != 1) {
    lead(since_start_us());
    loop();
    usleep(slow_us);
  }
}
