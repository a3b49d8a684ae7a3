/* J3 of the GPM2002 (Cong et al. 2008) as fast as we can write it in C: what our compiled kernel is measured against.

   The same mathematics as problems/_planar_kernels.py: the power of the radical centre, about B_1, in halved lengths.
   Candidates lie in the lanes, BLOCK vectors of them at a time to hide latencies; two samples share a division. */

#ifdef __AVX512F__
#define WIDTH 8
#else
#define WIDTH 4
#endif
#define BLOCK 4
#define LANES (WIDTH * BLOCK)

typedef double V __attribute__((vector_size(8 * WIDTH)));

static inline V all(double value) {
    V v;
    for (int i = 0; i < WIDTH; i++) v[i] = value;
    return v;
}

static inline void fraction(const V k[13][BLOCK], int b, const double *sample, V *above, V *below) {
    V c1 = all(sample[0]), s1 = all(sample[1]), c2 = all(sample[2]), s2 = all(sample[3]), c3 = all(sample[4]),
      s3 = all(sample[5]);
    V bx = k[4][b] * c1 - k[5][b] * s1, by = k[4][b] * s1 + k[5][b] * c1;
    V ux = (k[0][b] - bx) + k[6][b] * c2 - k[7][b] * s2, uy = (k[1][b] - by) + k[6][b] * s2 + k[7][b] * c2;
    V vx = (k[2][b] - bx) + k[8][b] * c3 - k[9][b] * s3, vy = (k[3][b] - by) + k[8][b] * s3 + k[9][b] * c3;
    V f = ux * ux + (uy * uy + k[11][b]), h = vx * vx + (vy * vy + k[12][b]);
    V d = ux * vy - uy * vx, fd = f * vy - h * uy, hd = h * ux - f * vx;
    *below = d * d;
    *above = (fd * fd + hd * hd) - k[10][b] * *below;
}

/* points: (count, dim); samples: (n, 6), cos and sin of the readings; out: (count), three times the sum of g^2. */
void batch(const double *points, long count, long dim, const double *samples, long n, const double *template,
           const long *free, double *out) {
    for (long first = 0; first < count; first += LANES) {
        long live = count - first < LANES ? count - first : LANES;
        long blocks = (live + WIDTH - 1) / WIDTH;
        V q[15][BLOCK], k[13][BLOCK], total[BLOCK];
        for (int i = 0; i < 15; i++)
            for (int b = 0; b < BLOCK; b++) q[i][b] = all(template[i]);
        for (long i = 0; i < dim; i++)
            for (long lane = 0; lane < live; lane++) ((double *)q[free[i]])[lane] = points[(first + lane) * dim + i];
        for (int b = 0; b < BLOCK; b++) {
            for (int i = 0; i < 4; i++) k[i][b] = 0.5 * (q[i + 2][b] - q[i % 2][b]);
            for (int i = 0; i < 3; i++) {
                k[4 + 2 * i][b] = 0.5 * q[6 + i][b];
                k[5 + 2 * i][b] = 0.5 * q[12 + i][b];
            }
            k[10][b] = q[9][b] * q[9][b];
            k[11][b] = 0.25 * (q[9][b] - q[10][b]) * (q[9][b] + q[10][b]);
            k[12][b] = 0.25 * (q[9][b] - q[11][b]) * (q[9][b] + q[11][b]);
            total[b] = all(0.0);
        }
        long j = 0;
        for (; j + 1 < n; j += 2) {
            V above, below, above2, below2;
#define PAIR(b)                                                    \
    fraction(k, b, samples + 6 * j, &above, &below);               \
    fraction(k, b, samples + 6 * j + 6, &above2, &below2);         \
    {                                                              \
        V r = 1.0 / (below * below2);                              \
        V g = above * (below2 * r), g2 = above2 * (below * r);     \
        total[b] += g * g;                                         \
        total[b] += g2 * g2;                                       \
    }
            if (blocks == BLOCK) {
                for (int b = 0; b < BLOCK; b++) { PAIR(b) }
            } else {
                for (int b = 0; b < blocks; b++) { PAIR(b) }
            }
        }
        for (; j < n; j++)
            for (int b = 0; b < BLOCK; b++) {
                V above, below;
                fraction(k, b, samples + 6 * j, &above, &below);
                V g = above / below;
                total[b] += g * g;
            }
        for (long lane = 0; lane < live; lane++) out[first + lane] = 3.0 * ((double *)total)[lane];
    }
}
