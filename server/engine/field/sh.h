// Real spherical harmonics of degree 4: 16 values of a unit direction, Condon-Shortley signs as
// the released code has them.
#ifndef RN_ENGINE_FIELD_SH_H
#define RN_ENGINE_FIELD_SH_H

#include "server/engine/field/real.h"

#define RN_SH_COUNT 16

RN_HD void rn_sh_encode(const rn_real d[3], rn_real out[RN_SH_COUNT]) {
    rn_real x = d[0], y = d[1], z = d[2];
    rn_real xy = x * y, xz = x * z, yz = y * z, x2 = x * x, y2 = y * y, z2 = z * z;
    out[0] = (rn_real)0.28209479177387814;
    out[1] = (rn_real)-0.48860251190291987 * y;
    out[2] = (rn_real)0.48860251190291987 * z;
    out[3] = (rn_real)-0.48860251190291987 * x;
    out[4] = (rn_real)1.0925484305920792 * xy;
    out[5] = (rn_real)-1.0925484305920792 * yz;
    out[6] = (rn_real)0.94617469575755997 * z2 - (rn_real)0.31539156525251999;
    out[7] = (rn_real)-1.0925484305920792 * xz;
    out[8] = (rn_real)0.54627421529603959 * (x2 - y2);
    out[9] = (rn_real)0.59004358992664352 * y * (-3 * x2 + y2);
    out[10] = (rn_real)2.8906114426405538 * xy * z;
    out[11] = (rn_real)0.45704579946446572 * y * (1 - 5 * z2);
    out[12] = (rn_real)0.3731763325901154 * z * (5 * z2 - 3);
    out[13] = (rn_real)0.45704579946446572 * x * (1 - 5 * z2);
    out[14] = (rn_real)1.4453057213202769 * z * (x2 - y2);
    out[15] = (rn_real)0.59004358992664352 * x * (-x2 + 3 * y2);
}

#endif
