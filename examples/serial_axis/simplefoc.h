// A brushless motor with SimpleFOC (Arduino-FOC 2.3 or later) on a 32-bit board: a haptic knob. The motor turns the
// handle itself; the place is the length of arc at RADIUS. Without a current sensor the torque is set by the voltage.

#include <SimpleFOC.h>

const uint16_t PERIOD_US = 1000;         // of the states: 1 kHz
const uint16_t WATCHDOG_MS = 20;         // the force ends after this time without a command
const uint32_t LIMIT_uN = 2000000;       // the maximum force at RADIUS
const uint32_t CONTINUOUS_uN = 500000;   // the force that the motor can hold continuously; 0: not known
const float RADIUS_nm = 20e6f;           // where the finger holds the knob: 20 mm
const uint32_t REACH_um = 60000;         // length of arc from the centre, in both directions
const uint32_t COUNT_nm = 30700;         // an AS5600 has 4096 counts a turn: 2 pi RADIUS / 4096
const uint32_t NOISE_nm = 2 * COUNT_nm;  // of its readings, from peak to peak
const bool ABSOLUTE = false;             // true: the knob goes less than a turn, and the sensor's zero is its centre
const uint8_t BUTTONS = 0;               // number of buttons, 4 at most
const int8_t DEAD_MAN = -1;              // which of them must be held; -1: none
const float VOLTS_AT_LIMIT = 6.0f;       // measure it: hang a weight on the handle

BLDCMotor motor(7);                      // pole pairs
BLDCDriver3PWM driver(9, 5, 6, 8);
MagneticSensorI2C sensor(AS5600_I2C);
float target_V = 0, angle_rad = 0, centre_rad = 0;
uint32_t sampled_us = 0;

uint32_t clock_us() { return micros(); }

void prepare() {
  sensor.init();
  motor.linkSensor(&sensor);
  driver.voltage_power_supply = 12;
  driver.init();
  motor.linkDriver(&driver);
  motor.voltage_limit = VOLTS_AT_LIMIT;
  motor.controller = MotionControlType::torque;
  motor.init();
  motor.initFOC();
}

void run() {  // called as often as it can be
  motor.loopFOC();
  angle_rad = motor.shaftAngle();
  sampled_us = clock_us();
  motor.move(target_V);
}

int32_t position_nm(uint32_t *at_us, int8_t *by) {
  *at_us = sampled_us;
  *by = 0;
  return (int32_t)((angle_rad - centre_rad) * RADIUS_nm);
}

void zero() { centre_rad = angle_rad; }

// Hold a force, in 32767ths of LIMIT_uN; returns the held force.
int16_t set_force(int16_t force) {
  target_V = force * (VOLTS_AT_LIMIT / 32767.0f);
  return force;
}

uint8_t buttons() { return 0; }
