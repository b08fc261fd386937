/* J2 plasticity (j2.c) that hydrogen makes softer: with the coverage psi, PREDEF(1) at the end of the increment, yield
   stress and hardening are 1 - s psi times those of the dry material, the linear form of Sofronis, Liang and Aravas
   (2001, Eur. J. Mech. A 20, 857-872). Fifth property: s. */
#define LEFT (1.0 - props[4] * (predef[0] + dpred[0]))
#define PROPERTIES 5
#define MEANING "E, nu, yield stress, hardening modulus, softening"
#include "j2.c"
