/* The sweeps of pdhe/kernels in C, on the same arrays and with the same arithmetic, for one thread; and two loops that
 * measure how fast memory can be read. Built as a shared library by pdhe.benchmarks.compiled. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#define BLOCK 1024

void gather_diffuse(int64_t n, const int64_t *offsets, const int32_t *neighbours, const double *rate,
                    const double *sink, const double *source, const uint8_t *held, const double *volume, double dt,
                    const double *psi, double *new_psi, double *supply)
{
    for (int64_t i = 0; i < n; i++) {
        double here = psi[i], total = 0.0;
        for (int64_t k = offsets[i]; k < offsets[i + 1]; k++)
            total += rate[k] * (psi[neighbours[k]] - here);
        if (held[i]) {
            new_psi[i] = here;
            supply[i] -= dt * volume[i] * total;
        } else {
            double through_edge = source[i] - sink[i] * here;
            new_psi[i] = here + dt * (total + through_edge);
            supply[i] += dt * volume[i] * through_edge;
        }
    }
}

/* x, u, spin, force: two numbers a node. */
void gather_rotation(int64_t n, const int64_t *offsets, const int32_t *neighbours, const double *x,
                     const double *cubed, const double *inverse, const double *share, const double *u, double *spin)
{
    for (int64_t i = 0; i < n; i++) {
        double px = x[2 * i], py = x[2 * i + 1], ux = u[2 * i], uy = u[2 * i + 1], total = 0.0;
        for (int64_t k = offsets[i]; k < offsets[i + 1]; k++) {
            int64_t j = neighbours[k];
            double dx = x[2 * j] - px, dy = x[2 * j + 1] - py;
            total += cubed[k] * (dx * dx + dy * dy) * (dx * (u[2 * j + 1] - uy) - dy * (u[2 * j] - ux));
        }
        double theta = total * inverse[i];
        spin[2 * i] = theta;
        spin[2 * i + 1] = theta * share[i];
    }
}

void gather_force(int64_t n, const int64_t *offsets, const int32_t *neighbours, const double *x, const double *cubed,
                  const double *share, double normal, double tangential, const double *u, const double *spin,
                  double *force)
{
    double half = 0.5 * tangential;
    for (int64_t i = 0; i < n; i++) {
        double px = x[2 * i], py = x[2 * i + 1], ux = u[2 * i], uy = u[2 * i + 1];
        double gi = share[i], ti = spin[2 * i + 1], fx = 0.0, fy = 0.0;
        for (int64_t k = offsets[i]; k < offsets[i + 1]; k++) {
            int64_t j = neighbours[k];
            double dx = x[2 * j] - px, dy = x[2 * j + 1] - py;
            double ex = u[2 * j] - ux, ey = u[2 * j + 1] - uy;
            double along = cubed[k] * normal * (dx * ex + dy * ey);
            double turn = (gi + share[j]) * (dx * ey - dy * ex) - (dx * dx + dy * dy) * (ti + spin[2 * j + 1]);
            double across = cubed[k] * half * turn;
            fx += along * dx - across * dy;
            fy += along * dy + across * dx;
        }
        force[2 * i] = fx;
        force[2 * i + 1] = fy;
    }
}

/* Lattice sweeps: weight[o * n + i] belongs to the bond from i to i + step[o]. */
static int64_t largest(int64_t a, int64_t b) { return a > b ? a : b; }
static int64_t smallest(int64_t a, int64_t b) { return a < b ? a : b; }

void lattice_diffuse(int64_t n, int64_t count, const int64_t *step, const double *rate, const double *sink,
                     const double *source, const uint8_t *held, const double *volume, double dt, const double *psi,
                     double *new_psi, double *supply)
{
    for (int64_t low = 0; low < n; low += BLOCK) {
        int64_t high = smallest(low + BLOCK, n);
        double total[BLOCK] = {0.0};
        for (int64_t o = 0; o < count; o++) {
            int64_t first = largest(low, -step[o]), last = smallest(high, n - step[o]);
            const double *restrict w = rate + o * n, *restrict there = psi + step[o];
            for (int64_t i = first; i < last; i++)
                total[i - low] += w[i] * (there[i] - psi[i]);
        }
        for (int64_t i = low; i < high; i++) {
            if (held[i]) {
                new_psi[i] = psi[i];
                supply[i] -= dt * volume[i] * total[i - low];
            } else {
                double through_edge = source[i] - sink[i] * psi[i];
                new_psi[i] = psi[i] + dt * (total[i - low] + through_edge);
                supply[i] += dt * volume[i] * through_edge;
            }
        }
    }
}

void lattice_rotation(int64_t n, int64_t count, const int64_t *step, const double *dx, const double *dy,
                      const double *cubed, const double *inverse, const double *share, const double *ux,
                      const double *uy, double *theta, double *turning)
{
    for (int64_t low = 0; low < n; low += BLOCK) {
        int64_t high = smallest(low + BLOCK, n);
        double total[BLOCK] = {0.0};
        for (int64_t o = 0; o < count; o++) {
            int64_t first = largest(low, -step[o]), last = smallest(high, n - step[o]), s = step[o];
            double square = dx[o] * dx[o] + dy[o] * dy[o], ax = -square * dy[o], ay = square * dx[o];
            const double *restrict w = cubed + o * n;
            for (int64_t i = first; i < last; i++)
                total[i - low] += w[i] * (ax * (ux[i + s] - ux[i]) + ay * (uy[i + s] - uy[i]));
        }
        for (int64_t i = low; i < high; i++) {
            theta[i] = total[i - low] * inverse[i];
            turning[i] = theta[i] * share[i];
        }
    }
}

void lattice_force(int64_t n, int64_t count, const int64_t *step, const double *dx, const double *dy,
                   const double *cubed, const double *share, double normal, double tangential, const double *ux,
                   const double *uy, const double *turning, double *fx, double *fy)
{
    double half = 0.5 * tangential;
    for (int64_t low = 0; low < n; low += BLOCK) {
        int64_t high = smallest(low + BLOCK, n);
        double sum_x[BLOCK] = {0.0}, sum_y[BLOCK] = {0.0};
        for (int64_t o = 0; o < count; o++) {
            int64_t first = largest(low, -step[o]), last = smallest(high, n - step[o]), s = step[o];
            double vx = dx[o], vy = dy[o], square = vx * vx + vy * vy;
            const double *restrict w = cubed + o * n;
            for (int64_t i = first; i < last; i++) {
                double ex = ux[i + s] - ux[i], ey = uy[i + s] - uy[i];
                double along = w[i] * normal * (vx * ex + vy * ey);
                double turn = (share[i] + share[i + s]) * (vx * ey - vy * ex) - square * (turning[i] + turning[i + s]);
                double across = w[i] * half * turn;
                sum_x[i - low] += along * vx - across * vy;
                sum_y[i - low] += along * vy + across * vx;
            }
        }
        for (int64_t i = low; i < high; i++) {
            fx[i] = sum_x[i - low];
            fy[i] = sum_y[i - low];
        }
    }
}

/* Sum of n numbers in eight independent lanes: what reading costs. */
double read_all(int64_t n, const double *a)
{
    double lane[8] = {0.0};
    for (int64_t i = 0; i + 8 <= n; i += 8)
        for (int k = 0; k < 8; k++)
            lane[k] += a[i + k];
    return lane[0] + lane[1] + lane[2] + lane[3] + lane[4] + lane[5] + lane[6] + lane[7];
}

/* a = b + q c: the triad of the STREAM benchmark. */
void triad(int64_t n, double q, const double *b, const double *c, double *a)
{
    for (int64_t i = 0; i < n; i++)
        a[i] = b[i] + q * c[i];
}
