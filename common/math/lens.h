// Lenses: how a camera's picture departs from a pinhole's. Each bends the point (x, y) = (X/Z, Y/Z)
// in front of the camera, and the pixel is (fx x' + cx, fy y' + cy) of the bent point.
#ifndef RN_COMMON_MATH_LENS_H
#define RN_COMMON_MATH_LENS_H

#define RN_LENS_PARAMETERS 12 // the most that a lens has

enum rn_lens {
    RN_LENS_PINHOLE,
    RN_LENS_OPENCV,             // rational radial and tangential (OpenCV's, COLMAP's FULL_OPENCV)
    RN_LENS_POLYNOMIAL,         // radial to r^8 and tangential (nerfstudio's)
    RN_LENS_FISHEYE,            // a polynomial of the angle from the axis (OpenCV's)
    RN_LENS_FOV,                // one angle (Devernay and Faugeras 2001)
    RN_LENS_THIN_PRISM_FISHEYE, // COLMAP's
    RN_LENS_EQUIRECTANGULAR,    // longitude and latitude, radians, in the place of x' and y'
    RN_LENS_COUNT
};

// What its parameters are called in files, in the order in which they are kept.
struct rn_lens_model {
    int count;
    double most; // of a parameter's size
    const char *parameters[RN_LENS_PARAMETERS];
};
extern const struct rn_lens_model rn_lens_models[RN_LENS_COUNT];
extern const char *const rn_lens_names[RN_LENS_COUNT]; // as files have them

#endif
