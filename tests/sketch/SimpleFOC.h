// The names that simplefoc.h uses, as Arduino-FOC 2.3 declares them (src/BLDCMotor.h, src/drivers/BLDCDriver3PWM.h,
// src/sensors/MagneticSensorI2C.h, src/common/base_classes/FOCMotor.h), so that a compiler without the library checks it.

#pragma once

enum MotionControlType : unsigned char { torque, velocity, angle };

struct MagneticSensorI2CConfig_s {};
inline MagneticSensorI2CConfig_s AS5600_I2C;

struct Sensor {};

struct MagneticSensorI2C : Sensor {
  MagneticSensorI2C(MagneticSensorI2CConfig_s) {}
  void init() {}
};

struct BLDCDriver3PWM {
  float voltage_power_supply;
  BLDCDriver3PWM(int, int, int, int = -1) {}
  int init() { return 1; }
};

struct BLDCMotor {
  float voltage_limit;
  MotionControlType controller;
  BLDCMotor(int) {}
  void linkSensor(Sensor *) {}
  void linkDriver(BLDCDriver3PWM *) {}
  int init() { return 1; }
  int initFOC() { return 1; }
  float shaftAngle() { return 0; }
  void loopFOC() {}
  void move(float) {}
};
