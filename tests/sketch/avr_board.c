// Runs a firmware in simavr (libsimavr 1.6) as an ATmega328P at 16 MHz, sends it a command after each state, and prints
// what it costs. In the last twentieth of the time no command comes. Built and read by tests/devices/test_serial_avr.py.
//
// avr_board FIRMWARE SECONDS ANSWER NAME=ADDRESS...: ANSWER 0: it sends no force; for each function, the calls, the
// mean cycles of a call with the interrupts in it, and the mean without them.

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

enum { MOST = 16, STATE = 20, COMMAND = 7 };

struct function {
  const char *name;
  uint32_t address;
  uint64_t calls, inclusive, exclusive;
};

static struct function functions[MOST];
static int function_count;
static struct { int which; uint32_t stack; uint64_t since, inner; } running[64];
static int depth;

static avr_t *avr;
static avr_irq_t *to_board;
static uint64_t bytes, states, first_cycle, last_cycle;
static uint32_t first_us, last_us;
static uint8_t unread[64];
static int unread_count, answers;
static uint16_t number, answered;
static uint64_t silent_cycle = ~0ull;  // from then on no command is sent
static uint64_t due_cycle;  // of the next byte to the board
static uint8_t out[64];
static int out_count, out_at;

static uint16_t crc16(const uint8_t *data, int count) {
  uint16_t crc = 0xFFFF;
  while (count--) {
    crc ^= (uint16_t)(*data++ << 8);
    for (int bit = 0; bit < 8; bit++) crc = crc & 0x8000 ? (uint16_t)(crc << 1 ^ 0x1021) : (uint16_t)(crc << 1);
  }
  return crc;
}

static void command(char mark, uint16_t which, int16_t force) {
  uint8_t frame[COMMAND] = {mark, which & 255, which >> 8, force & 255, (uint16_t)force >> 8};
  uint16_t crc = crc16(frame, COMMAND - 2);
  frame[5] = crc >> 8;
  frame[6] = crc & 255;
  if (out_at == out_count) out_at = out_count = 0;
  if (out_count + COMMAND > (int)sizeof out) return;
  memcpy(out + out_count, frame, COMMAND);
  out_count += COMMAND;
}

static void on_byte(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq, (void)param;
  bytes++;
  unread[unread_count++] = (uint8_t)value;
  if (unread_count < STATE) return;
  if (unread[0] != 'S' || crc16(unread, STATE)) {
    memmove(unread, unread + 1, --unread_count);
    return;
  }
  unread_count = 0;
  memcpy(&answered, unread + 2, 2);
  memcpy(&last_us, unread + 4, 4);
  last_cycle = avr->cycle;
  if (!states++) first_us = last_us, first_cycle = last_cycle;
  if (!answers || last_cycle >= silent_cycle) return;
  number++;
  command('F', number, (int16_t)(number * 257));
}

static void on_adc(struct avr_irq_t *irq, uint32_t value, void *param) {  // the magnet turns once in 50 ms
  (void)irq, (void)value, (void)param;
  double turn = (double)avr->cycle / avr->frequency / 0.05;
  avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC2), (uint32_t)(250 + 4492 * (turn - (uint64_t)turn)));
}

static int pwm(void) { return avr->data[0x44] & 0x20 ? avr->data[0x48] : 0; }  // TCCR0A's COM0B1, OCR0B: pin 5

static uint32_t stack(void) { return avr->data[R_SPL] | avr->data[R_SPH] << 8; }

static void watch(void) {
  while (depth && stack() > running[depth - 1].stack) {
    depth--;
    struct function *f = &functions[running[depth].which];
    uint64_t took = avr->cycle - running[depth].since;
    f->calls++;
    f->inclusive += took;
    f->exclusive += took - running[depth].inner;
    if (depth) running[depth - 1].inner += took;
  }
  for (int k = 0; k < function_count; k++)
    if (avr->pc == functions[k].address && depth < 64) {
      running[depth].which = k;
      running[depth].stack = stack();
      running[depth].since = avr->cycle;
      running[depth++].inner = 0;
    }
}

int main(int count, char **words) {
  elf_firmware_t firmware = {0};
  if (count < 4 || elf_read_firmware(words[1], &firmware)) return 2;
  double seconds = atof(words[2]);
  answers = atoi(words[3]);
  for (int k = 4; k < count && function_count < MOST; k++) {
    char *equals = strchr(words[k], '=');
    *equals = 0;
    functions[function_count++] = (struct function){words[k], (uint32_t)strtoul(equals + 1, 0, 16), 0, 0, 0};
  }
  avr = avr_make_mcu_by_name("atmega328p");
  avr_init(avr);
  avr->frequency = 16000000;
  avr->vcc = avr->avcc = avr->aref = 5000;
  avr_load_firmware(avr, &firmware);
  uint32_t flags = 0;
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  to_board = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, 0);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), on_adc, 0);
  uint64_t until = (uint64_t)(seconds * avr->frequency);
  int asked = 0, homed = 0, duty[2] = {0, 0};
  silent_cycle = until - until / 20;
  while (avr->cycle < until) {
    int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) return 3;
    watch();
    if (!homed && states) homed = 1, command('H', 0, 0);
    duty[avr->cycle > silent_cycle + avr->frequency / 40] |= pwm();
    if (!asked && avr->cycle > until / 2) asked = 1, command('Q', 0, 0);
    if (out_at < out_count && avr->cycle >= due_cycle) {  // a byte in 10 us: 1 Mbaud
      avr_raise_irq(to_board, out[out_at++]);
      due_cycle = avr->cycle + 160;
    }
  }
  double lasted = (double)(last_cycle - first_cycle) / avr->frequency;
  printf("rate_hz %.3f\n", (states - 1) / lasted);
  printf("clock %.6f\n", (last_us - first_us) * 1e-6 / lasted);
  printf("bytes_s %.1f\n", bytes / seconds);
  printf("commands %u %u\n", number, answered);
  printf("pwm %d %d\n", duty[0], duty[1]);
  for (int k = 0; k < function_count; k++) {
    struct function *f = &functions[k];
    double calls = f->calls ? (double)f->calls : 1;
    printf("%s %llu %.1f %.1f\n", f->name, (unsigned long long)f->calls, f->inclusive / calls, f->exclusive / calls);
  }
  return 0;
}
