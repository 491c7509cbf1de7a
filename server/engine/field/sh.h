// Real spherical harmonics of degree 4: 16 values of a unit direction, Condon-Shortley signs as
// the released code has them.
#ifndef RN_ENGINE_FIELD_SH_H
#define RN_ENGINE_FIELD_SH_H

#include "server/engine/field/real.h"

#define RN_SH_COUNT 16

// One function a type: numbers of it, or vectors that hold a direction a lane. Constants are of
// type NUMBER.
#define RN_SH_FUNCTION(NAME, TYPE, NUMBER)                                                         \
    RN_HD void NAME(const TYPE d[3], TYPE out[RN_SH_COUNT]) {                                      \
        TYPE x = d[0], y = d[1], z = d[2];                                                         \
        TYPE xy = x * y, xz = x * z, yz = y * z, x2 = x * x, y2 = y * y, z2 = z * z;               \
        out[0] = x - x + (NUMBER)0.28209479177387814;                                              \
        out[1] = (NUMBER)-0.48860251190291987 * y;                                                 \
        out[2] = (NUMBER)0.48860251190291987 * z;                                                  \
        out[3] = (NUMBER)-0.48860251190291987 * x;                                                 \
        out[4] = (NUMBER)1.0925484305920792 * xy;                                                  \
        out[5] = (NUMBER)-1.0925484305920792 * yz;                                                 \
        out[6] = (NUMBER)0.94617469575755997 * z2 - (NUMBER)0.31539156525251999;                   \
        out[7] = (NUMBER)-1.0925484305920792 * xz;                                                 \
        out[8] = (NUMBER)0.54627421529603959 * (x2 - y2);                                          \
        out[9] = (NUMBER)0.59004358992664352 * y * (y2 - (NUMBER)3 * x2);                          \
        out[10] = (NUMBER)2.8906114426405538 * xy * z;                                             \
        out[11] = (NUMBER)0.45704579946446572 * y * ((NUMBER)1 - (NUMBER)5 * z2);                  \
        out[12] = (NUMBER)0.3731763325901154 * z * ((NUMBER)5 * z2 - (NUMBER)3);                   \
        out[13] = (NUMBER)0.45704579946446572 * x * ((NUMBER)1 - (NUMBER)5 * z2);                  \
        out[14] = (NUMBER)1.4453057213202769 * z * (x2 - y2);                                      \
        out[15] = (NUMBER)0.59004358992664352 * x * ((NUMBER)3 * y2 - x2);                         \
    }
RN_SH_FUNCTION(rn_sh_encode, rn_real, rn_real)

#endif
