// What the sketch uses of Arduino (docs.arduino.cc, Language Reference), for this machine and for a bare compiler.

#pragma once
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <math.h>

#define HIGH 1
#define LOW 0
#define INPUT_PULLUP 2
#define OUTPUT 1
#define CHANGE 1

uint32_t micros();
void pinMode(int pin, int mode);
void digitalWrite(int pin, int value);
void analogWrite(int pin, int value);
void analogWriteFreq(uint32_t hertz);                  // arduino-pico
void analogWriteFrequency(int pin, uint32_t hertz);    // Teensy, and arduino-esp32 from 3.0 on
int digitalRead(int pin);
int digitalPinToInterrupt(int pin);
void attachInterrupt(int interrupt, void (*called)(), int mode);
void noInterrupts();
void interrupts();

struct Port {
  void begin(unsigned long baud);
  int available();
  int read();
  int availableForWrite();
  size_t write(const uint8_t *bytes, size_t count);
};
extern Port Serial;
