// A board on this machine: what the sketch uses of Arduino, with standard input and output as its serial port. The
// handle is led: it goes to and fro by 10 mm, once a second. Built by tests/devices/test_serial_sketch.py.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <unistd.h>
#include <fcntl.h>

using std::min;

enum { INPUT_PULLUP, OUTPUT, CHANGE, LOW = 0, HIGH = 1 };

static uint64_t since_start_us() {
  static const auto start = std::chrono::steady_clock::now();
  return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now() - start).count();
}

// the clock begins shortly before it wraps, as it does on a board after 71 minutes
uint32_t micros() { return (uint32_t)(since_start_us() + 0xFFFFFFFFull - 500000); }
uint32_t millis() { return (uint32_t)(since_start_us() / 1000); }
void pinMode(int, int) {}
void digitalWrite(int, int) {}
void analogWrite(int, int) {}
int digitalRead(int) { return HIGH; }
int digitalPinToInterrupt(int pin) { return pin; }
void attachInterrupt(int, void (*)(), int) {}
void noInterrupts() {}
void interrupts() {}

struct Port {
  int waiting = -1;
  void begin(long) {}
  bool available() {
    unsigned char c;
    if (waiting < 0 && ::read(0, &c, 1) == 1) waiting = c;
    return waiting >= 0;
  }
  char read() {
    char c = (char)waiting;
    waiting = -1;
    return c;
  }
  void print(const char *text) {
    if (::write(1, text, strlen(text)) < 0) _exit(0);
  }
} Serial;

#include SKETCH

int main() {
  fcntl(0, F_SETFL, O_NONBLOCK);
  setup();
  while (getppid() != 1) {
    int32_t wanted = (int32_t)(10e6 * sin(6.283185307 * since_start_us() * 1e-6) / COUNT_nm);
    static int32_t led = 0;
    counts += wanted - led;
    led = wanted;
    loop();
    usleep(50);
  }
}
