// The scans that `benchmarks/integration.py` hands to the programs of this folder, and the clock that times them.
#pragma once

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <vector>

struct Scan {
    double x, y, yaw;           // metres, radians: of the sensor in the common frame
    std::vector<float> ranges;  // metres; 0: says nothing; beyond max_range: nothing in range
};

struct Log {
    double cell, first, step, max_range;  // metres, radians
    std::vector<Scan> scans;
};

template <typename T>
T take(std::FILE* file) {
    T value;
    if (std::fread(&value, sizeof value, 1, file) != 1) std::exit(2);
    return value;
}

inline Log read_log(const char* path) {
    std::FILE* file = std::fopen(path, "rb");
    if (file == nullptr) std::exit(2);
    Log log;
    const auto scans = take<std::int32_t>(file), beams = take<std::int32_t>(file);
    log.cell = take<double>(file);
    log.first = take<double>(file);
    log.step = take<double>(file);
    log.max_range = take<double>(file);
    for (int k = 0; k < scans; ++k) {
        Scan scan;
        scan.x = take<double>(file);
        scan.y = take<double>(file);
        scan.yaw = take<double>(file);
        for (int beam = 0; beam < beams; ++beam) scan.ranges.push_back(take<float>(file));
        log.scans.push_back(scan);
    }
    std::fclose(file);
    return log;
}

// Seconds that this thread has computed: what others do on the machine is not in it.
inline double seconds() {
    timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}
