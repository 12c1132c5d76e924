// Constants of ground growing. What a caller may vary is in GroundParameters.
#pragma once

#include <cstddef>
#include <cstdint>

namespace docdepth {

/// The search radius of seeds is not doubled beyond this [m], unless no point is nearer.
constexpr double kMaxSeedRadius = 16.0;
/// Behind a step, ground is sought in cells of this edge on the plan [m].
constexpr double kStepCell = 1.0;
/// Voxels on either side of the origin of a map: 2^20, which is 31 km at 3 cm.
constexpr std::int64_t kMapReach = std::int64_t{1} << 20;
/// Points whose hash slots are fetched ahead of use.
constexpr std::size_t kPrefetchAhead = 8;
/// A thread takes at most so many leaves of the front at once.
constexpr std::size_t kLeavesAtOnce = 8;
/// Larger nodes of the octree are split [points].
constexpr std::uint32_t kLeafSize = 32;
/// Reach of the first search for neighbours, in distances expected for evenly spread points.
constexpr double kFirstReach = 0.7;
/// After a search that was too short, reach farther than needed by this factor, for other points.
constexpr double kReachMargin = 1.2;

}  // namespace docdepth
