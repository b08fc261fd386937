/* Isotropic linear elasticity as an Abaqus user material: properties E and nu, no state variables.
   Plane strain and solids (NDI = 3), plane stress (NDI = 2). Only for materials named ELASTIC... */
#include <stdio.h>
#include <string.h>

extern void xit_(void);

void umat_(double *stress, double *statev, double *ddsdde, double *sse, double *spd, double *scd, double *rpl,
           double *ddsddt, double *drplde, double *drpldt, double *stran, double *dstran, double *time,
           double *dtime, double *temp, double *dtemp, double *predef, double *dpred, char *cmname, int *ndi,
           int *nshr, int *ntens, int *nstatv, double *props, int *nprops, double *coords, double *drot,
           double *pnewdt, double *celent, double *dfgrd0, double *dfgrd1, int *noel, int *npt, int *layer,
           int *kspt, int *jstep, int *kinc, size_t length)
{
    const int n = *ntens;
    if (length != 80 || strncmp(cmname, "ELASTIC", 7) != 0) {
        fprintf(stderr, "elastic.c: no material %.20s here, only ELASTIC...\n", cmname);
        xit_();
    }
    if (*nprops != 2) {
        fprintf(stderr, "elastic.c: needs 2 properties, E and nu, not %d\n", *nprops);
        xit_();
    }
    const double young = props[0], nu = props[1], shear = young / (2.0 * (1.0 + nu));
    const double lame = *ndi == 3 ? young * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)) : young * nu / (1.0 - nu * nu);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            ddsdde[i + n * j] = i < *ndi && j < *ndi ? lame + (i == j ? 2.0 * shear : 0.0) : (i == j ? shear : 0.0);
    *sse = 0.0;
    for (int i = 0; i < n; i++) {
        stress[i] = 0.0;
        for (int j = 0; j < n; j++)
            stress[i] += ddsdde[i + n * j] * (stran[j] + dstran[j]);
        *sse += 0.5 * stress[i] * (stran[i] + dstran[i]);
    }
}
