// Small symmetric matrices.
#ifndef RN_COMMON_MATH_SYMMETRIC_H
#define RN_COMMON_MATH_SYMMETRIC_H

// Their eigenvectors, by Jacobi's rotations (Golub and Van Loan, section 8.5): the columns of
// `axes` are orthonormal, and `a` is left with the eigenvalues on its diagonal, in no order.
void rn_symmetric_axes3(double a[3][3], double axes[3][3]);
void rn_symmetric_axes4(double a[4][4], double axes[4][4]);

#endif
