// What OctoMap takes to insert a scan as a cloud of points.
#include "scans.hpp"

#include <cmath>
#include <octomap/octomap.h>

class Octomap {
    octomap::OcTree tree{0.05};
    octomap::Pointcloud cloud;
    octomap::point3d sensor;
    float angle_min, angle_increment;

public:
    explicit Octomap(const Scans& all) : angle_min(all.angle_min), angle_increment(all.angle_increment) {}

    void prepare(const Scan& scan) {
        cloud.clear();
        sensor = octomap::point3d(static_cast<float>(scan.x), static_cast<float>(scan.y), 0.0f);
        for (size_t beam = 0; beam < scan.ranges.size(); ++beam) {
            const double range = scan.ranges[beam];
            if (!(range > 0.0 && range <= 30.0)) continue;
            const double bearing = scan.yaw + angle_min + angle_increment * static_cast<double>(beam);
            cloud.push_back(static_cast<float>(scan.x + range * std::cos(bearing)),
                            static_cast<float>(scan.y + range * std::sin(bearing)), 0.0f);
        }
    }

    void insert() { tree.insertPointCloud(cloud, sensor, 30.0, false, true); }
};

int main(int count, char** arguments) { return run<Octomap>(count, arguments); }
