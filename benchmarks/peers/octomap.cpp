// OctoMap's OcTree on a log: prints the seconds of one integration and the leaves that it has afterwards.
#include <octomap/octomap.h>

#include <cmath>

#include "scans.hpp"

int main(int, char** arguments) {
    const Log log = read_log(arguments[1]);
    octomap::OcTree tree(log.cell);
    tree.setProbHit(0.70);
    tree.setProbMiss(0.40);
    octomap::Pointcloud points;  // made before the clock starts for the first scan only: it is part of the work
    const double begin = seconds();
    for (const auto& scan : log.scans) {
        const octomap::point3d origin(static_cast<float>(scan.x), static_cast<float>(scan.y), 0);
        points.clear();
        for (std::size_t beam = 0; beam < scan.ranges.size(); ++beam) {
            const float range = scan.ranges[beam];
            if (!(range > 0)) continue;
            const double angle = scan.yaw + log.first + beam * log.step;
            points.push_back(static_cast<float>(scan.x + range * std::cos(angle)),
                             static_cast<float>(scan.y + range * std::sin(angle)), 0);
        }
        tree.insertPointCloud(points, origin, log.max_range, /* lazy_eval */ true, /* discretize */ false);
    }
    tree.updateInnerOccupancy();
    const double taken = seconds() - begin;
    std::printf("%.9f %zu\n", taken, tree.getNumLeafNodes());
}
