// A serial axis for hapnet: the protocol of hapnet/ext/devices/serial_axis.md, version 2.
//
// Choose the file of your board here, and put your pins and your mechanics into it. Nothing else depends on the board.

#ifndef BOARD
#define BOARD "encoder.h"  // a 32-bit board (Teensy, RP2040, ESP32) with an encoder and a motor driver; the others:
                           // "simplefoc.h": a brushless motor with SimpleFOC; "hapkit.h": a Hapkit (ATmega328P)
#endif

#include <Arduino.h>
#include BOARD
#include "axis.h"

void setup() { begin_axis(); }

void loop() { run_axis(); }
