/* J2 plasticity with linear isotropic hardening as an Abaqus user material, by radial return with its consistent
   tangent (Simo and Hughes 1998, box 3.1). Properties: E, nu, yield stress, hardening modulus (of the plastic strain).
   One state variable, the equivalent plastic strain. Plane strain and solids: NDI = 3.
   What includes this file may say by LEFT which share of yield stress and hardening there is (j2_hydrogen.c). */
#include <math.h>
#include <stdio.h>

#ifndef LEFT
#define LEFT 1.0
#define PROPERTIES 4
#define MEANING "E, nu, yield stress, hardening modulus"
#endif

extern void xit_(void);

void umat_(double *stress, double *statev, double *ddsdde, double *sse, double *spd, double *scd, double *rpl,
           double *ddsddt, double *drplde, double *drpldt, double *stran, double *dstran, double *time,
           double *dtime, double *temp, double *dtemp, double *predef, double *dpred, char *cmname, int *ndi,
           int *nshr, int *ntens, int *nstatv, double *props, int *nprops, double *coords, double *drot,
           double *pnewdt, double *celent, double *dfgrd0, double *dfgrd1, int *noel, int *npt, int *layer,
           int *kspt, int *jstep, int *kinc, size_t length)
{
    const int n = *ntens;
    if (*nprops != PROPERTIES || *nstatv != 1 || *ndi != 3) {
        fprintf(stderr, "j2: needs %d properties (" MEANING "), 1 state variable and NDI = 3, not %d, %d and %d\n",
                PROPERTIES, *nprops, *nstatv, *ndi);
        xit_();
    }
    const double left = LEFT, young = props[0], nu = props[1], yield = left * props[2], hardening = left * props[3];
    const double shear = young / (2.0 * (1.0 + nu)), bulk = young / (3.0 * (1.0 - 2.0 * nu));
    double normal[6], swell = dstran[0] + dstran[1] + dstran[2], square = 0.0;
    double pressure = (stress[0] + stress[1] + stress[2]) / 3.0;
    for (int i = 0; i < n; i++) {
        const double deviator = i < 3 ? stress[i] - pressure : stress[i];
        normal[i] = deviator + (i < 3 ? 2.0 * shear * (dstran[i] - swell / 3.0) : shear * dstran[i]);
        square += (i < 3 ? 1.0 : 2.0) * normal[i] * normal[i];
    }
    pressure += bulk * swell;
    const double trial = sqrt(1.5 * square), over = trial - (yield + hardening * statev[0]);
    double plastic = 0.0, keep = 1.0, turn = 0.0;
    if (over > 0.0) {
        plastic = over / (3.0 * shear + hardening);
        keep = 1.0 - 3.0 * shear * plastic / trial;
        turn = 6.0 * shear * shear * (plastic / trial - 1.0 / (3.0 * shear + hardening));
        *spd += plastic * (yield + hardening * (statev[0] + 0.5 * plastic));
        statev[0] += plastic;
    }
    const double length_of = square > 0.0 ? sqrt(square) : 1.0;
    square = 0.0;
    for (int i = 0; i < n; i++) {
        stress[i] = keep * normal[i] + (i < 3 ? pressure : 0.0);
        square += (i < 3 ? 1.0 : 2.0) * keep * keep * normal[i] * normal[i];
        normal[i] /= length_of;
    }
    *sse = square / (4.0 * shear) + pressure * pressure / (2.0 * bulk);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            double entry = turn * normal[i] * normal[j];
            if (i < 3 && j < 3)
                entry += bulk - 2.0 * shear * keep / 3.0;
            if (i == j)
                entry += (i < 3 ? 2.0 : 1.0) * shear * keep;
            ddsdde[i + n * j] = entry;
        }
}
