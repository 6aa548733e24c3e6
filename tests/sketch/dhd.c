/* A stand-in for libdhd, with one omega: the functions that the driver needs, as documented. Built by the tests.
   The handle is a mass of 0.2 kg in a hand of 100 N/m and 6 Ns/m that goes 50 mm to and fro along our x, which is its y. */

#include <math.h>
#include <string.h>
#include <time.h>

static double x[3], v[3], force[3], last_s, start_s;
static int open_ = 0, brake = 0, reset = 0, failing = 0, watchdog = 0, gravity = -1, enabled = 0, stopped = 0;
static double commanded_s;
static unsigned int mask = 0;
static double frame_[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};

static double now_s(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void advance(void) {
  double until = now_s();
  while (last_s < until) {
    double h = fmin(2e-4, until - last_s), age = last_s - start_s;
    double goal[3] = {0.0, 0.05 * (0.5 - 0.5 * cos(2.0 * age)), 0.0};
    if (watchdog && last_s - commanded_s > watchdog * 125e-6) memset(force, 0, sizeof force);
    for (int k = 0; k < 3; k++) {
      v[k] += h * (100.0 * (goal[k] - x[k]) - 6.0 * v[k] + (brake ? 0.0 : force[k])) / 0.2;
      x[k] += h * v[k];
    }
    last_s += h;
  }
}

/* what a test changes and looks at */
void stub_set(int fail, int brakes, int resets, unsigned int buttons) { failing = fail; brake = brakes; reset = resets; mask = buttons; }
void stub_frame(const double *f) { memcpy(frame_, f, sizeof frame_); }
int stub_state(int which) { int all[] = {open_, watchdog, gravity, enabled, stopped}; return all[which]; }

int dhdGetDeviceCount(void) { return 1; }
int dhdOpenID(signed char id) {
  if (id != 0) return -1;
  open_ = 1; stopped = 0;
  last_s = start_s = commanded_s = now_s();
  memset(x, 0, sizeof x); memset(v, 0, sizeof v); memset(force, 0, sizeof force);
  return 0;
}
int dhdClose(signed char id) { (void)id; open_ = 0; return 0; }
int dhdStop(signed char id) { (void)id; memset(force, 0, sizeof force); stopped = 1; return 0; }
int dhdEnableExpertMode(void) { return 0; }
int dhdEnableForce(unsigned char on, signed char id) { (void)id; enabled = on; return 0; }
int dhdSetGravityCompensation(int on, signed char id) { (void)id; gravity = on; return 0; }
int dhdSetWatchdog(unsigned char ticks, signed char id) { (void)id; watchdog = ticks; return 0; }
unsigned char dhdHasWrist(signed char id) { (void)id; return 1; }
const char *dhdErrorGetLastStr(void) { return "no such device, or it does not answer"; }
const char *dhdGetSystemName(signed char id) { (void)id; return "omega.6 stand-in"; }
unsigned int dhdGetButtonMask(signed char id) { (void)id; return mask; }
int dhdGetStatus(int status[16], signed char id) {
  (void)id;
  memset(status, 0, 16 * sizeof(int));
  status[3] = reset; status[6] = brake;
  return 0;
}
int dhdGetOrientationFrame(double f[9], signed char id) { (void)id; memcpy(f, frame_, sizeof frame_); return 0; }
static int three(const double *of, double *a, double *b, double *c) {
  if (failing) return -1;
  advance();
  *a = of[0]; *b = of[1]; *c = of[2];
  return 0;
}
int dhdGetPosition(double *a, double *b, double *c, signed char id) { (void)id; return three(x, a, b, c); }
int dhdGetLinearVelocity(double *a, double *b, double *c, signed char id) { (void)id; return three(v, a, b, c); }
int dhdGetForce(double *a, double *b, double *c, signed char id) { (void)id; return three(force, a, b, c); }
int dhdSetForce(double a, double b, double c, signed char id) {
  (void)id;
  if (failing) return -1;
  advance();
  double length = sqrt(a * a + b * b + c * c), most = 12.0, share = length > most ? most / length : 1.0;
  force[0] = share * a; force[1] = share * b; force[2] = share * c;
  commanded_s = now_s();
  return length > most ? 2 : 0;
}
