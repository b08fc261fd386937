// The loop of the thesis in plain C++: families as vectors of vectors, geometry worked out again for every bond with
// square roots, and per load step a number of explicit diffusion sweeps and one force sweep with its check of the bonds.
//
//     thesis_loop PROBLEM STEPS SUBSTEPS RESULT
//
// PROBLEM is a binary file that pdhe.benchmarks.thesis_loop writes. RESULT receives coverage and force of every node
// after the last step. The seconds of processor time spent in diffusion and in mechanics go to standard output, as JSON.

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <vector>

struct Vector {
    double x, y;
};

// Processor time.
static double seconds()
{
    return double(std::clock()) / CLOCKS_PER_SEC;
}

template <class T> static std::vector<T> read(std::FILE *file, std::size_t count)
{
    std::vector<T> values(count);
    if (std::fread(values.data(), sizeof(T), count, file) != count) {
        std::fprintf(stderr, "problem file too short\n");
        std::exit(1);
    }
    return values;
}

int main(int count, char **arguments)
{
    if (count != 5)
        return 1;
    std::FILE *file = std::fopen(arguments[1], "rb");
    if (!file)
        return 1;
    const int steps = std::atoi(arguments[2]), substeps = std::atoi(arguments[3]);
    const std::int64_t nodes = read<std::int64_t>(file, 1)[0];
    // Numbers of the problem: spacing, horizon, k_n, k_t, critical stretch, diffusion constant, step in time.
    const std::vector<double> number = read<double>(file, 7);
    const double spacing = number[0], horizon = number[1], normal = number[2], tangential = number[3];
    const double critical = number[4], exchange = number[5], dt = number[6];
    const std::vector<Vector> position = read<Vector>(file, nodes), displacement = read<Vector>(file, nodes);
    const std::vector<double> volume = read<double>(file, nodes);
    std::vector<double> coverage = read<double>(file, nodes);
    const std::vector<std::uint8_t> held = read<std::uint8_t>(file, nodes);
    std::vector<std::vector<int>> neighbours(nodes);
    std::vector<std::vector<char>> intact(nodes);
    for (std::int64_t i = 0; i < nodes; i++) {
        const std::int64_t size = read<std::int64_t>(file, 1)[0];
        for (const std::int32_t j : read<std::int32_t>(file, size))
            neighbours[i].push_back(j);
        for (const std::uint8_t whole : read<std::uint8_t>(file, size))
            intact[i].push_back(char(whole));
    }
    std::fclose(file);

    std::vector<double> next(nodes), damage(nodes);
    std::vector<Vector> force(nodes);
    double in_diffusion = 0.0, in_mechanics = 0.0;
    long broken = 0;
    for (int step = 0; step < steps; step++) {
        const double start = seconds();
        for (int sub = 0; sub < substeps; sub++) {
            for (std::int64_t i = 0; i < nodes; i++) {
                double sum = 0.0;
                for (std::size_t k = 0; k < neighbours[i].size(); k++) {
                    const int j = neighbours[i][k];
                    const double dx = position[j].x - position[i].x, dy = position[j].y - position[i].y;
                    const double r = std::sqrt(dx * dx + dy * dy);
                    double share = 1.0;
                    if (r > horizon - 0.5 * spacing)
                        share = (horizon + 0.5 * spacing - r) / spacing;
                    sum += exchange * share * volume[j] / (r * r) * (coverage[j] - coverage[i]);
                }
                next[i] = held[i] ? coverage[i] : coverage[i] + dt * sum;
            }
            coverage.swap(next);
        }
        const double middle = seconds();
        for (std::int64_t i = 0; i < nodes; i++) {
            Vector total = {0.0, 0.0};
            double whole = 0.0, lost = 0.0;
            for (std::size_t k = 0; k < neighbours[i].size(); k++) {
                const int j = neighbours[i][k];
                const double dx = position[j].x - position[i].x, dy = position[j].y - position[i].y;
                const double ex = displacement[j].x - displacement[i].x, ey = displacement[j].y - displacement[i].y;
                const double r = std::sqrt(dx * dx + dy * dy);
                const double now = std::sqrt((dx + ex) * (dx + ex) + (dy + ey) * (dy + ey));
                double share = 1.0;
                if (r > horizon - 0.5 * spacing)
                    share = (horizon + 0.5 * spacing - r) / spacing;
                const double psi = 0.5 * (coverage[i] + coverage[j]);
                if ((now - r) / r > critical * (1.0 - 1.0467 * psi + 0.1687 * psi * psi) && intact[i][k]) {
                    intact[i][k] = 0;
                    broken++;
                }
                whole += volume[j];
                if (!intact[i][k]) {
                    lost += volume[j];
                    continue;
                }
                const double nx = dx / r, ny = dy / r;
                const double along = ex * nx + ey * ny, across = ey * nx - ex * ny;
                const double weight = share * volume[i] * volume[j] / r;
                total.x += weight * (normal * along * nx - tangential * across * ny);
                total.y += weight * (normal * along * ny + tangential * across * nx);
            }
            force[i] = total;
            damage[i] = lost / whole;
        }
        in_diffusion += middle - start;
        in_mechanics += seconds() - middle;
    }
    file = std::fopen(arguments[4], "wb");
    if (!file)
        return 1;
    std::fwrite(coverage.data(), sizeof(double), nodes, file);
    std::fwrite(force.data(), sizeof(Vector), nodes, file);
    std::fwrite(damage.data(), sizeof(double), nodes, file);
    std::fclose(file);
    std::printf("{\"diffusion\": %.9f, \"mechanics\": %.9f, \"broken\": %ld}\n", in_diffusion, in_mechanics, broken);
    return 0;
}
