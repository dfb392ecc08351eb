// MRPT's COccupancyGridMap2D on a log: prints the seconds of one integration and the cells that it knows afterwards.
#include <mrpt/maps/COccupancyGridMap2D.h>
#include <mrpt/obs/CObservation2DRangeScan.h>
#include <mrpt/poses/CPose3D.h>

#include "scans.hpp"

int main(int, char** arguments) {
    const Log log = read_log(arguments[1]);
    const int beams = static_cast<int>(log.scans.front().ranges.size());
    std::vector<mrpt::obs::CObservation2DRangeScan> observations(log.scans.size());
    for (std::size_t k = 0; k < log.scans.size(); ++k) {
        auto& observation = observations[k];
        observation.rightToLeft = true;
        observation.aperture = static_cast<float>((beams - 1) * log.step);
        observation.maxRange = 1000;
        observation.sensorPose = mrpt::poses::CPose3D(0, 0, 0, log.first + (beams - 1) * log.step / 2, 0, 0);
        observation.resizeScan(beams);
        for (int beam = 0; beam < beams; ++beam) {
            const float range = log.scans[k].ranges[beam];
            observation.setScanRange(beam, range);
            observation.setScanRangeValidity(beam, range > 0);
        }
    }
    mrpt::maps::COccupancyGridMap2D map(-5, 5, -5, 5, static_cast<float>(log.cell));
    map.insertionOptions.maxDistanceInsertion = static_cast<float>(log.max_range);
    map.insertionOptions.maxOccupancyUpdateCertainty = 0.70f;  // 0.85 nat
    map.insertionOptions.maxFreenessUpdateCertainty = 0.60f;   // 0.40 nat
    map.insertionOptions.wideningBeamsWithDistance = false;
    map.insertionOptions.decimation = 1;

    const double begin = seconds();
    for (std::size_t k = 0; k < log.scans.size(); ++k) {
        const auto& scan = log.scans[k];
        map.insertObservation(observations[k], mrpt::poses::CPose3D(scan.x, scan.y, 0, scan.yaw, 0, 0));
    }
    const double taken = seconds() - begin;

    long known = 0;
    for (const auto cell : map.getRawMap()) known += cell != 0;
    std::printf("%.9f %ld\n", taken, known);
}
