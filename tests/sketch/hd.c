/* A stand-in for libHD of OpenHaptics, with one Phantom Omni. Built by the tests.

   Source: types, names and constants as in the public headers hdDefines.h, hdDevice.h and hdScheduler.h (3.0 and 3.30, which
   agree), behaviour as in the maker's "API Reference Manual" and "Programmer's Guide" 3.0 and in his HD examples:
   * one scheduler thread runs every callback once a tick, the highest priority first, until it returns HD_CALLBACK_DONE;
   * state is read at hdBeginFrame, and a force goes out at hdEndFrame; one frame a tick (HD_ILLEGAL_BEGIN, HD_ILLEGAL_END);
   * to set a force outside of a frame is HD_FRAME_ERROR; a wrong type is HD_INVALID_INPUT_TYPE, a wrong name HD_INVALID_ENUM;
   * "it will just continue rendering the last force" in frames that set none (AnchoredSpringForce.c);
   * one stack of errors for all threads, the newest first;
   * after an HD_EXCEEDED_... "the device amplifiers will toggle and then ramp to normal output";
   * an inkwell calibration needs the stylus in the inkwell (NEEDS_MANUAL_INPUT), then hdUpdateCalibration, while the
     scheduler runs; before it positions are wrong.
   Not documented, and the worst case here: a lost connection or a scheduler without callbacks leaves the last force.

   The handle is a mass of 0.1 kg in a hand of 100 N/m and 6 Ns/m that goes 50 mm to and fro along x. */

#define _GNU_SOURCE
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef struct { unsigned int errorCode; int internalErrorCode; unsigned int hHD; } HDErrorInfo;
typedef unsigned int (*Callback)(void *);
enum { SUCCESS, INVALID_ENUM = 0x100, INVALID_OPERATION = 0x102, INVALID_INPUT_TYPE, BAD_HANDLE, WARM_MOTORS = 0x200,
       EXCEEDED_MAX_FORCE, EXCEEDED_MAX_VELOCITY = 0x203, DEVICE_FAULT = 0x300, DEVICE_ALREADY_INITIATED, COMM_ERROR,
       TIMER_ERROR = 0x304, ILLEGAL_BEGIN = 0x400, ILLEGAL_END, FRAME_ERROR, SCHEDULER_FULL = 0x501 };
enum { CURRENT_BUTTONS = 0x2000, CURRENT_POSITION = 0x2050, CURRENT_VELOCITY, CURRENT_TRANSFORM, VERSION = 0x2500, DEVICE_MODEL_TYPE,
       DEVICE_SERIAL_NUMBER = 0x2504, MAX_WORKSPACE_DIMENSIONS = 0x2550, CALIBRATION_STYLE = 0x2555, NOMINAL_MAX_STIFFNESS = 0x2602, NOMINAL_MAX_FORCE,
       NOMINAL_MAX_CONTINUOUS_FORCE, MOTOR_TEMPERATURE, CURRENT_FORCE = 0x2700, FORCE_OUTPUT = 0x4000,
       CALIBRATION_OK = 0x5000, CALIBRATION_NEEDS_UPDATE, CALIBRATION_NEEDS_MANUAL_INPUT, INKWELL = 4 };

#define SLOTS 8
#define TICK_NS 1000000
#define MOST 100000
static const double MAX_N = 3.3, RAMP_NPS = 10.0, AMPLIFIERS_S = 0.2;

static struct { Callback call; void *data; unsigned short priority; unsigned long handle; } slots[SLOTS];
static unsigned long handles;
static pthread_t thread;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t done = PTHREAD_COND_INITIALIZER;
static HDErrorInfo stack[64];
static int depth, running, open_, in_frame, framed, output = 1, disabled_at_end, ticks, frames_;
static int calibration = CALIBRATION_OK, code, buttons, stalled, unset;
static double x[3], v[3], seen_x[3], seen_v[3], transform[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
static double commanded[3], held[3], hot[6], off_until_s, last_s, start_s, work_J, most_J, late_us[MOST];
static double fault_at_s = INFINITY, fault_s, enabled_s = INFINITY;
static int fault_code;

static int by_hand;
static double hand_s;

static double now_s(void) {
  if (by_hand) return hand_s;
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void fail(unsigned int what) {
  pthread_mutex_lock(&lock);
  if (depth < 64) stack[depth++] = (HDErrorInfo){what, -1, 0};
  pthread_mutex_unlock(&lock);
}

static double power(double now) { return now < off_until_s ? 0.0 : fmin(1.0, RAMP_NPS * (now - off_until_s) / MAX_N); }

static void advance(double until) {
  while (last_s < until) {
    double h = fmin(2e-4, until - last_s), share = output ? power(last_s) : 0.0;
    double goal[3] = {0.05 * (0.5 - 0.5 * cos(2.0 * (last_s - start_s))), 0.0, 0.0};
    for (int k = 0; k < 3; k++) {
      double f = share * held[k];
      v[k] += h * (100.0 * (goal[k] - x[k]) - 6.0 * v[k] + f) / 0.1;
      x[k] += h * v[k];
      work_J += h * v[k] * f;
    }
    most_J = fmax(most_J, work_J);
    last_s += h;
  }
}

/* what a test changes and looks at */
void stub_calibration(int state) { calibration = state; }
void stub_error(int what) { code = what; }
void stub_buttons(int mask) { buttons = mask; }
void stub_hot(double level) { for (int k = 0; k < 6; k++) hot[k] = level; }
void stub_stall(int on) { stalled = on; }
void stub_transform(const double *t) { memcpy(transform, t, sizeof transform); }
void stub_force(double *f) { for (int k = 0; k < 3; k++) f[k] = output ? power(now_s()) * held[k] : 0.0; }
double stub_work(void) { return work_J; }
double stub_most(void) { return most_J; }
int stub_state(int which) { int all[] = {open_, running, output, disabled_at_end, frames_, unset, depth}; return all[which]; }
HDErrorInfo hdGetError(void) {
  pthread_mutex_lock(&lock);
  HDErrorInfo top = depth ? stack[--depth] : (HDErrorInfo){SUCCESS, 0, 0};
  pthread_mutex_unlock(&lock);
  return top;
}
unsigned int hdInitDevice(const char *name) {
  if (name && strcmp(name, "Default Device")) { fail(DEVICE_FAULT); return 0xFFFFFFFF; }
  if (open_) { fail(DEVICE_ALREADY_INITIATED); return 0xFFFFFFFF; }
  open_ = 1; output = 1;
  in_frame = framed = disabled_at_end = ticks = frames_ = unset = depth = code = stalled = buttons = 0;
  memset(x, 0, sizeof x); memset(v, 0, sizeof v); memset(held, 0, sizeof held); memset(hot, 0, sizeof hot);
  work_J = most_J = off_until_s = 0.0;
  calibration = getenv("STUB_CALIBRATION") ? strtol(getenv("STUB_CALIBRATION"), NULL, 0) : CALIBRATION_OK;
  start_s = last_s = now_s();
  enabled_s = INFINITY;
  if (getenv("STUB_FAULT")) sscanf(getenv("STUB_FAULT"), "%lf:%lf:%i", &fault_at_s, &fault_s, &fault_code);
  return 0;
}
void hdDisableDevice(unsigned int device) { (void)device; disabled_at_end = !output; open_ = 0; }
void hdEnable(unsigned int what) {
  if (what != FORCE_OUTPUT) { fail(INVALID_ENUM); return; }
  output = 1;
  enabled_s = now_s();
}
void hdDisable(unsigned int what) { if (what == FORCE_OUTPUT) output = 0; else fail(INVALID_ENUM); }
unsigned char hdIsEnabled(unsigned int what) { if (what != FORCE_OUTPUT) fail(INVALID_ENUM); return what == FORCE_OUTPUT && output; }
const char *hdGetString(unsigned int what) {
  static const char *strings[] = {"3.30.0", "PHANTOM Omni stand-in", "4.3", "hapnet", "00000000"};
  if (what < VERSION || what > DEVICE_SERIAL_NUMBER) { fail(INVALID_ENUM); return NULL; }
  return strings[what - VERSION];
}

static int active(void) {
  double age = now_s() - enabled_s; /* a fault counts from when the motors were switched on */
  return age > fault_at_s && age < fault_at_s + fault_s ? fault_code : code;
}

void hdBeginFrame(unsigned int device) {
  if (device != 0 || !open_) { fail(BAD_HANDLE); return; }
  if (in_frame || framed) { fail(ILLEGAL_BEGIN); return; }
  in_frame = 1;
  unset = 1;
  int what = active();
  if (what == COMM_ERROR || what == DEVICE_FAULT) { fail(what); return; } /* its state stays as it was */
  double off = calibration == CALIBRATION_OK ? 0.0 : 0.06;
  for (int k = 0; k < 3; k++) { seen_x[k] = 1e3 * (x[k] + off); seen_v[k] = 1e3 * v[k]; }
}
void hdEndFrame(unsigned int device) {
  if (device != 0 || !in_frame) { fail(ILLEGAL_END); return; }
  in_frame = 0; framed = 1; frames_++;
  int what = active();
  double length = sqrt(commanded[0] * commanded[0] + commanded[1] * commanded[1] + commanded[2] * commanded[2]), now = now_s();
  if (what == COMM_ERROR || what == DEVICE_FAULT) return;
  if (!unset) memcpy(held, commanded, sizeof held);
  if (length > MAX_N + 1e-9) what = EXCEEDED_MAX_FORCE;
  if (hot[0] >= 1.0 && length > 0.0) what = WARM_MOTORS;
  if (!what) return;
  fail(what);
  if (what == WARM_MOTORS) memset(held, 0, sizeof held);
  else if (what > WARM_MOTORS && what <= EXCEEDED_MAX_VELOCITY) off_until_s = now + AMPLIFIERS_S;
}

void hdGetDoublev(unsigned int what, double *to) {
  static const double limits[6] = {-210.0, -110.0, -85.0, 210.0, 205.0, 130.0};
  switch (what) {
    case CURRENT_POSITION: memcpy(to, seen_x, sizeof seen_x); break;
    case CURRENT_VELOCITY: memcpy(to, seen_v, sizeof seen_v); break;
    case CURRENT_TRANSFORM: memcpy(to, transform, sizeof transform); memcpy(to + 12, seen_x, sizeof seen_x); break;
    case CURRENT_FORCE: memcpy(to, commanded, sizeof commanded); break;
    case MAX_WORKSPACE_DIMENSIONS: memcpy(to, limits, sizeof limits); break;
    case NOMINAL_MAX_STIFFNESS: *to = 0.9; break;
    case NOMINAL_MAX_FORCE: *to = MAX_N; break;
    case NOMINAL_MAX_CONTINUOUS_FORCE: *to = 0.88; break;
    case MOTOR_TEMPERATURE: if (hot[0] < 0.0) fail(INVALID_ENUM); else memcpy(to, hot, 3 * sizeof *hot); break;
    case CURRENT_BUTTONS: case CALIBRATION_STYLE: case DEVICE_MODEL_TYPE: fail(INVALID_INPUT_TYPE); break;
    default: fail(INVALID_ENUM);
  }
}
void hdGetIntegerv(unsigned int what, int *to) {
  if (what == CURRENT_BUTTONS) *to = buttons;
  else if (what == CALIBRATION_STYLE) *to = INKWELL;
  else fail(what >= CURRENT_POSITION && what <= CURRENT_FORCE ? INVALID_INPUT_TYPE : INVALID_ENUM);
}
void hdSetDoublev(unsigned int what, const double *from) {
  if (what != CURRENT_FORCE) { fail(INVALID_ENUM); return; }
  if (!in_frame) { fail(FRAME_ERROR); return; }
  memcpy(commanded, from, sizeof commanded);
  unset = 0;
}

unsigned int hdCheckCalibration(void) { if (!open_) fail(DEVICE_FAULT); return calibration; }
void hdUpdateCalibration(unsigned int style) {
  if (style != INKWELL || !running || calibration == CALIBRATION_NEEDS_MANUAL_INPUT) { fail(DEVICE_FAULT); return; }
  calibration = CALIBRATION_OK;
}

/* one tick: each callback once, the highest priority first */
static void tick(void) {
  advance(now_s());
  if (stalled) return;
  framed = 0;
  for (unsigned long seen = 0;;) {
    pthread_mutex_lock(&lock);
    int best = -1;
    for (int k = 0; k < SLOTS; k++)
      if (slots[k].call && !(seen >> k & 1) && (best < 0 || slots[k].priority > slots[best].priority)) best = k;
    Callback call = best < 0 ? NULL : slots[best].call;
    void *data = best < 0 ? NULL : slots[best].data;
    pthread_mutex_unlock(&lock);
    if (!call) return;
    seen |= 1ul << best;
    if (call(data)) continue;
    pthread_mutex_lock(&lock);
    slots[best].call = NULL;
    pthread_cond_broadcast(&done);
    pthread_mutex_unlock(&lock);
  }
}

static void *run(void *nothing) {
  (void)nothing;
  struct timespec due;
  clock_gettime(CLOCK_MONOTONIC, &due);
  while (running) {
    due.tv_nsec += TICK_NS;
    if (due.tv_nsec >= 1000000000) { due.tv_nsec -= 1000000000; due.tv_sec++; }
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
    tick();
    double behind = now_s() - due.tv_sec - 1e-9 * due.tv_nsec;
    if (ticks < MOST) late_us[ticks++] = 1e6 * behind;
    if (behind > 2e-3) clock_gettime(CLOCK_MONOTONIC, &due); /* what is missed is missed */
  }
  return NULL;
}

/* by hand: no thread, the test makes each tick, and its time is this library's */
void stub_by_hand(int on) { by_hand = on; hand_s = 1.0; }
double stub_now(void) { return now_s(); }
void stub_tick(double seconds) { hand_s += seconds; tick(); }
void stub_put(const double *position, const double *velocity) { memcpy(x, position, sizeof x); memcpy(v, velocity, sizeof v); }

void hdStartScheduler(void) {
  if (running || !open_) { fail(TIMER_ERROR); return; }
  running = 1;
  off_until_s = now_s();
  if (!by_hand && pthread_create(&thread, NULL, run, NULL)) { running = 0; fail(TIMER_ERROR); }
}
void hdStopScheduler(void) {
  if (!running) { fail(TIMER_ERROR); return; }
  running = 0;
  if (!by_hand) pthread_join(thread, NULL);
  if (!getenv("STUB_LATENESS")) return;
  FILE *to = fopen(getenv("STUB_LATENESS"), "w"); /* how late after its time each tick's callbacks were done [us] */
  for (int k = 0; to && k < ticks; k++) fprintf(to, "%.1f\n", late_us[k]);
  if (to) fclose(to);
}
static int schedule(Callback call, void *data, unsigned short priority, int waits) {
  if (waits && by_hand) { /* as from the scheduler's own thread */
    call(data);
    return 0;
  }
  pthread_mutex_lock(&lock);
  int k = 0;
  while (k < SLOTS && slots[k].call) k++;
  if (k < SLOTS) {
    slots[k].call = call; slots[k].data = data; slots[k].priority = priority; slots[k].handle = ++handles;
    while (waits && running && slots[k].call) pthread_cond_wait(&done, &lock);
  }
  pthread_mutex_unlock(&lock);
  if (k == SLOTS) fail(SCHEDULER_FULL);
  return k;
}
unsigned long hdScheduleAsynchronous(Callback call, void *data, unsigned short priority) {
  int k = schedule(call, data, priority, 0);
  return k < SLOTS ? slots[k].handle : 0;
}
void hdScheduleSynchronous(Callback call, void *data, unsigned short priority) { schedule(call, data, priority, 1); }
void hdUnschedule(unsigned long handle) {
  for (int k = 0; k < SLOTS; k++)
    if (slots[k].call && slots[k].handle == handle) { slots[k].call = NULL; return; }
  fail(INVALID_OPERATION);
}
unsigned int hdGetCurrentDevice(void) { return open_ ? 0 : 0xFFFFFFFF; }
void hdMakeCurrentDevice(unsigned int device) { if (device || !open_) fail(BAD_HANDLE); }
