// What MRPT's occupancy grid takes to insert a scan, by rays, with its own settings but the range.
#include "scans.hpp"

#include <mrpt/maps/COccupancyGridMap2D.h>
#include <mrpt/obs/CObservation2DRangeScan.h>
#include <mrpt/poses/CPose3D.h>

class Mrpt {
    mrpt::maps::COccupancyGridMap2D grid;
    mrpt::obs::CObservation2DRangeScan observation;
    mrpt::poses::CPose3D pose;

public:
    explicit Mrpt(const Scans& all) {
        // Made large enough beforehand, as the bare ray walk's: it would copy itself to grow.
        double low[2] = {1e9, 1e9}, high[2] = {-1e9, -1e9};
        for (const Scan& scan : all.scans) {
            for (int axis = 0; axis < 2; ++axis) {
                const double at = axis ? scan.y : scan.x;
                low[axis] = std::min(low[axis], at - 31.0);
                high[axis] = std::max(high[axis], at + 31.0);
            }
        }
        grid.setSize(low[0], high[0], low[1], high[1], 0.05);
        grid.insertionOptions.maxDistanceInsertion = 30.0f;
        grid.insertionOptions.considerInvalidRangesAsFreeSpace = false;
        observation.aperture = all.angle_increment * static_cast<float>(all.beams - 1);
        observation.rightToLeft = true;
        observation.maxRange = 30.0f;
        observation.resizeScan(all.beams);
    }

    void prepare(const Scan& scan) {
        for (size_t beam = 0; beam < scan.ranges.size(); ++beam) {
            observation.setScanRange(beam, scan.ranges[beam]);
            observation.setScanRangeValidity(beam, scan.ranges[beam] > 0.0f && scan.ranges[beam] <= 30.0f);
        }
        pose = mrpt::poses::CPose3D(scan.x, scan.y, 0.0, scan.yaw, 0.0, 0.0);
    }

    void insert() { grid.insertObservation(observation, pose); }
};

int main(int count, char** arguments) { return run<Mrpt>(count, arguments); }
