/* A stand-in for libdhd and, with -DROBOTIC, for libdrd, with one omega. Built by the tests.

   Source: declarations and constants as in dhdc.h and drdc.h of Force Dimension's SDK (3.7: DHD_MAX_STATUS 16; 3.14 and
   later: 17, as the package forcedimension-core has it; older ones 12 to 15), behaviour as in the SDK's documentation:
   * the firmware disables forces when no force command has come for the watchdog's time; it says why in
     DHD_STATUS_FORCEOFFCAUSE, and only dhdEnableForce enables them again;
   * dhdStop and brakes end force mode; the force button does too, until it is pressed again;
   * dhdGetStatus writes as many ints as the library knows, whatever room there is.
   Not documented, and the worst case here: dhdEnableForce does not count as a force command for the watchdog.

   The handle is a mass of 0.2 kg in a hand of 100 N/m and 6 Ns/m that goes 50 mm to and fro along our x, which is its y.
   Its grip, if it has one, is a mass of 0.05 kg between fingers of 100 N/m and 2 Ns/m that close it from 25 mm to 5 mm.
   As in the SDK's examples, a force that opens it is positive, and of a left hand force and velocity are negative. */

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

enum { POWER, CONNECTED, STARTED, RESET, IDLE, FORCE, BRAKE, TORQUE, WRIST, ERROR, GRAVITY, TIMEGUARD, WRIST_INIT,
       REDUNDANCY, FORCEOFFCAUSE, LOCKS, AXIS_CHECKED };
enum { NONE, BUTTON, VELOCITY, WATCHDOG, SOFTWARE };

static double x[3], v[3], force[3], torque[3], last_s, start_s, commanded_s, passed_s;
static int open_, brakes = 1, button, reset, failing, watchdog, gravity = -1, enabled, cause, stopped, regulating;
static int active_wrist, gripper, left;
static double gap = 0.025, rate, grip;
static int powered = 1, locks, ints = 17, enables, supported = 1, inits;
static unsigned int mask;
static double frame_[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
static double off_at_s = INFINITY;
static int off_cause;

static double now_s(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec + passed_s;
}

static void disable(int why) {
  if (enabled) cause = why;
  enabled = 0;
  memset(force, 0, sizeof force); memset(torque, 0, sizeof torque);
  grip = 0.0;
}

static int renders(void) { return enabled && !brakes && !button && !reset && powered; }

static void advance(void) {
  double until = now_s();
  while (last_s < until) {
    double h = fmin(2e-4, until - last_s), age = last_s - start_s;
    double goal[3] = {0.0, 0.05 * (0.5 - 0.5 * cos(2.0 * age)), 0.0};
    if (watchdog && last_s - commanded_s > watchdog * 125e-6) disable(WATCHDOG);
    if (age > off_at_s) { disable(off_cause); off_at_s = INFINITY; }
    for (int k = 0; k < 3; k++) {
      v[k] += h * (100.0 * (goal[k] - x[k]) - 6.0 * v[k] + (renders() ? force[k] : 0.0)) / 0.2;
      x[k] += h * v[k];
    }
    double fingers = 0.015 + 0.01 * cos(2.0 * age);
    rate += h * (100.0 * (fingers - gap) - 2.0 * rate + (renders() ? grip : 0.0)) / 0.05;
    gap += h * rate;
    if (gap < 0.0) gap = rate = 0.0;
    last_s += h;
  }
}

/* what a test changes and looks at */
void stub_set(int fail, int pressed, int resets, unsigned int buttons) { failing = fail; button = pressed; reset = resets; mask = buttons; }
void stub_frame(const double *f) { memcpy(frame_, f, sizeof frame_); }
void stub_ints(int count) { ints = count; }
void stub_pass(double seconds) { passed_s += seconds; }
void stub_wrist(int active) { active_wrist = active; }
void stub_grip(int active, int left_handed) { gripper = active; left = left_handed; }
void stub_off(int why) { advance(); disable(why); }
void stub_more(int power, int lock, int support) { powered = power; locks = lock; supported = support; }
int stub_state(int which) {
  int all[] = {open_, watchdog, gravity, enabled, stopped, brakes, enables, regulating, inits};
  return all[which];
}

int dhdGetDeviceCount(void) { return 1; }
int dhdOpenID(char id) {
  if (id != 0) return -1;
  open_ = 1; stopped = enabled = watchdog = cause = enables = regulating = inits = 0; brakes = 1;
  last_s = start_s = commanded_s = now_s();
  memset(x, 0, sizeof x); memset(v, 0, sizeof v); memset(force, 0, sizeof force);
  gap = 0.025; rate = grip = 0.0;
  if (getenv("STUB_GRIP")) gripper = atoi(getenv("STUB_GRIP"));
  if (getenv("STUB_WRIST")) active_wrist = atoi(getenv("STUB_WRIST"));
  if (getenv("STUB_INTS")) ints = atoi(getenv("STUB_INTS"));
  if (getenv("STUB_OFF")) sscanf(getenv("STUB_OFF"), "%lf:%d", &off_at_s, &off_cause);
  return 0;
}
int dhdClose(char id) { (void)id; open_ = 0; return 0; }
int dhdStop(char id) { (void)id; disable(SOFTWARE); brakes = 1; stopped = 1; return 0; }
int dhdEnableExpertMode(void) { return 0; }
int dhdEnableForce(unsigned char on, char id) {
  (void)id;
  advance();
  if (reset || !powered || failing) return -1;
  enables += on;
  if (on) { enabled = 1; brakes = 0; cause = NONE; } else disable(SOFTWARE);
  return 0;
}
int dhdSetBrakes(int on, char id) { (void)id; brakes = on; if (on) disable(SOFTWARE); return 0; }
int dhdSetGravityCompensation(int on, char id) { (void)id; gravity = on; return 0; }
int dhdSetWatchdog(unsigned char ticks, char id) { (void)id; advance(); watchdog = ticks; return 0; }
bool dhdHasWrist(char id) { (void)id; return true; }
bool dhdHasActiveWrist(char id) { (void)id; return active_wrist; }
const char *dhdErrorGetLastStr(void) { return "no such device, or it does not answer"; }
const char *dhdGetSystemName(char id) { (void)id; return "omega.6 stand-in"; }
unsigned int dhdGetButtonMask(char id) { (void)id; return mask; }
int dhdGetStatus(int status[], char id) {
  (void)id;
  if (failing) return -1;
  advance();
  int all[256] = {0};
  all[POWER] = powered; all[CONNECTED] = all[STARTED] = 1; all[RESET] = reset;
  all[FORCE] = renders(); all[BRAKE] = brakes || button; all[IDLE] = !enabled && !brakes;
  all[GRAVITY] = gravity; all[FORCEOFFCAUSE] = button ? BUTTON : cause; all[LOCKS] = locks;
  memcpy(status, all, ints * sizeof(int));
  return 0;
}
int dhdGetOrientationFrame(double f[3][3], char id) { (void)id; memcpy(f, frame_, sizeof frame_); return 0; }
static int three(const double *of, double *a, double *b, double *c) {
  if (failing) return -1;
  advance();
  *a = of[0]; *b = of[1]; *c = of[2];
  return 0;
}
int dhdGetPosition(double *a, double *b, double *c, char id) { (void)id; return three(x, a, b, c); }
int dhdGetLinearVelocity(double *a, double *b, double *c, char id) { (void)id; return three(v, a, b, c); }
int dhdGetForce(double *a, double *b, double *c, char id) { (void)id; return three(force, a, b, c); }
int dhdSetForce(double a, double b, double c, char id) {
  (void)id;
  if (failing) return -1;
  advance();
  double length = sqrt(a * a + b * b + c * c), most = 12.0, share = length > most ? most / length : 1.0;
  commanded_s = now_s();
  if (!renders() || regulating) { memset(force, 0, sizeof force); grip = 0.0; return 0; }
  force[0] = share * a; force[1] = share * b; force[2] = share * c;
  return length > most ? 2 : 0; /* DHD_MOTOR_SATURATED */
}

int dhdSetForceAndTorque(double a, double b, double c, double d, double e, double f, char id) {
  double length = sqrt(d * d + e * e + f * f), most = 0.4, share = length > most ? most / length : 1.0; /* sigma.7 */
  int saturated = dhdSetForce(a, b, c, id);
  if (saturated < 0 || !active_wrist || !renders() || regulating) { memset(torque, 0, sizeof torque); return saturated; }
  torque[0] = share * d; torque[1] = share * e; torque[2] = share * f;
  return length > most ? 2 : saturated;
}
int dhdGetForceAndTorque(double *a, double *b, double *c, double *d, double *e, double *f, char id) {
  (void)id;
  return three(force, a, b, c) < 0 ? -1 : three(torque, d, e, f);
}

bool dhdHasActiveGripper(char id) { (void)id; return gripper; }
bool dhdIsLeftHanded(char id) { (void)id; return left; }
int dhdGetGripperGap(double *a, char id) { (void)id; if (failing) return -1; advance(); *a = gap; return 0; }
int dhdGetGripperLinearVelocity(double *a, char id) {
  (void)id;
  if (failing) return -1;
  advance();
  *a = left ? -rate : rate;
  return 0;
}
int dhdSetForceAndGripperForce(double a, double b, double c, double d, char id) {
  int saturated = dhdSetForce(a, b, c, id);
  if (saturated < 0 || !gripper || !renders() || regulating) { grip = 0.0; return saturated; }
  double limited = fmax(-8.0, fmin(8.0, d)); /* omega.7 */
  grip = left ? -limited : limited;
  return limited != d ? 2 : saturated;
}
int dhdGetForceAndTorqueAndGripperForce(double *a, double *b, double *c, double *d, double *e, double *f, double *g, char id) {
  if (dhdGetForceAndTorque(a, b, c, d, e, f, id) < 0) return -1;
  *g = left ? -grip : grip;
  return 0;
}

#ifdef ROBOTIC
int drdOpenID(char id) { return dhdOpenID(id); }
int drdClose(char id) { return dhdClose(id); }
bool drdIsSupported(char id) { (void)id; return supported; }
bool drdIsInitialized(char id) { (void)id; return !reset; }
int drdAutoInit(char id) { (void)id; inits++; if (failing) return -1; reset = 0; enabled = 1; brakes = 0; regulating = 1; return 0; }
int drdStop(bool on, char id) { (void)id; regulating = 0; if (!on) { disable(SOFTWARE); brakes = 1; } return 0; }
#endif
