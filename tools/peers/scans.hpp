// Scans with the poses at which they were taken, as `cargo bench --bench insert` writes them, and how inserting them is timed.
//
// The file, little endian: u32 beams, f32 angle_min, f32 angle_increment (rad); then for each scan f64 x, y, yaw (m, m, rad; the
// scanner in the middle of the scan) and f32 range (m) for each beam, 0 where it returned nothing.
#pragma once
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <vector>

struct Scan {
    double x, y, yaw;
    std::vector<float> ranges;
};

struct Scans {
    uint32_t beams;
    float angle_min, angle_increment;
    std::vector<Scan> scans;

    static Scans load(const char* path) {
        std::ifstream file(path, std::ios::binary);
        const auto take = [&file](void* to, size_t bytes) {
            return static_cast<bool>(file.read(static_cast<char*>(to), static_cast<std::streamsize>(bytes)));
        };
        Scans all{};
        if (!take(&all.beams, 4) || !take(&all.angle_min, 4) || !take(&all.angle_increment, 4)) {
            std::fprintf(stderr, "%s: no scans in it\n", path);
            std::exit(1);
        }
        Scan scan{};
        scan.ranges.resize(all.beams);
        while (take(&scan.x, 24) && take(scan.ranges.data(), 4 * all.beams)) all.scans.push_back(scan);
        return all;
    }
};

/// CPU time of this thread (us).
inline double cpu_us() {
    timespec time{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return static_cast<double>(time.tv_sec) * 1e6 + static_cast<double>(time.tv_nsec) / 1e3;
}

/// Arguments: the file, rounds, most scans. Prints, for each scan, the least time of all rounds (us). `Map` is made anew for
/// each round; what it does in `prepare` is not timed.
template <class Map>
int run(int count, char** arguments) {
    if (count != 4) {
        std::fprintf(stderr, "usage: %s FILE ROUNDS MOST-SCANS\n", arguments[0]);
        return 2;
    }
    Scans all = Scans::load(arguments[1]);
    all.scans.resize(std::min<size_t>(all.scans.size(), std::strtoul(arguments[3], nullptr, 10)));
    std::vector<double> best(all.scans.size(), 1e300);
    for (int round = 0; round < std::atoi(arguments[2]); ++round) {
        Map map(all);
        for (size_t number = 0; number < all.scans.size(); ++number) {
            map.prepare(all.scans[number]);
            const double before = cpu_us();
            map.insert();
            best[number] = std::min(best[number], cpu_us() - before);
        }
    }
    for (const double time : best) std::printf("%.2f\n", time);
    return 0;
}
