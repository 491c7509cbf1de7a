// AMX: products of 16x32 by 32x16 bf16 tiles, 8,192 multiply-adds an instruction.
#include "server/engine/bench/peak.h"

#include <immintrin.h>
#include <stdint.h>
#include <string.h>

#define TILE_MACS 8192

struct tile_config {
    uint8_t palette, start_row, reserved[14];
    uint16_t row_bytes[16];
    uint8_t rows[16];
};

static void configure(void) {
    _Alignas(64) struct tile_config config = {.palette = 1};
    for (int i = 0; i < 8; i++) {
        config.row_bytes[i] = 64;
        config.rows[i] = 16;
    }
    __asm__ volatile("" ::"r"(&config) : "memory"); // the stores come before the load
    _tile_loadconfig(&config);
}

// Tiles 0-3 are sums, the others operands.
static double finish(size_t rounds, float *sink) {
    _Alignas(64) float out[256];
    _tile_stored(0, out, 64);
    _tile_release();
    *sink = out[0] * 1e-30f;
    return (double)rounds * 4 * TILE_MACS;
}

static void clear_sums(void) {
    _tile_zero(0);
    _tile_zero(1);
    _tile_zero(2);
    _tile_zero(3);
}

double rn_peak_amx(size_t rounds, float *sink) {
    configure();
    clear_sums();
    _tile_zero(4);
    _tile_zero(5);
    _tile_zero(6);
    _tile_zero(7);
    for (size_t k = 0; k < rounds; k++) {
        _tile_dpbf16ps(0, 4, 6);
        _tile_dpbf16ps(1, 4, 7);
        _tile_dpbf16ps(2, 5, 6);
        _tile_dpbf16ps(3, 5, 7);
    }
    return finish(rounds, sink);
}

double rn_peak_amx_l1(size_t rounds, float *sink) {
    _Alignas(64) static uint8_t operands[8][1024];
    memset(operands, 0x3c, sizeof operands); // memory never written may load five times as slowly
    configure();
    clear_sums();
    for (size_t k = 0; k < rounds; k++) {
        _tile_loadd(4, operands[0], 64);
        _tile_loadd(5, operands[1], 64);
        _tile_dpbf16ps(0, 4, 5);
        _tile_loadd(6, operands[2], 64);
        _tile_loadd(7, operands[3], 64);
        _tile_dpbf16ps(1, 6, 7);
        _tile_loadd(4, operands[4], 64);
        _tile_loadd(5, operands[5], 64);
        _tile_dpbf16ps(2, 4, 5);
        _tile_loadd(6, operands[6], 64);
        _tile_loadd(7, operands[7], 64);
        _tile_dpbf16ps(3, 6, 7);
    }
    return finish(rounds, sink);
}
