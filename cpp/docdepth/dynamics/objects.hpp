// Evidence shared within connected objects of a sweep: what moves, moves as a whole.
#pragma once

#include <cstdint>
#include <vector>

#include "docdepth/geometry/places.hpp"
#include "docdepth/geometry/types.hpp"
#include "docdepth/surface/surface.hpp"

namespace docdepth {

struct ObjectParameters {
  float cluster_distance = 0.3f;  ///< neighbouring returns farther apart are not connected [m],
  float cluster_distance_growth =
      0.05f;                     ///< or, where beams are wider apart, than so much of their range
  int min_cluster_size = 6;      ///< connected dynamic points that believe each other
  float neighbor_radius = 1.0f;  ///< nearer to what is dynamic a single point is believed, too [m]
  int clear_votes = 2;           ///< or with that many dynamic votes
  float clear_ratio = 4;         ///< that outnumber the static ones so many times
  int min_object_points = 10;    ///< an object has that many points
  float dynamic_share = 0.5f;    ///< and moves when that share of those with votes is dynamic
  float min_dynamic_share = 0.1f;    ///< and that share of all of them,
  float min_object_width = 1.5f;     ///< or when it is that wide and long, from above [m],
  float min_object_height = 0.3f;    ///< and that high [m]
  float observed_free_share = 0.6f;  ///< and the place of that share was seen free:
  int observed_free_votes = 2;       ///< by that many key frames,
  float max_static_ratio = 8;  ///< and by one to so many that saw it taken; others always stood
  int isolated_votes = 2;      ///< most static votes more than dynamic ones of a loose point
};

/// Objects of a sweep, connected points off the ground: of each point the row of the first one.
///
/// Returns are connected by the edges of the sweep's surface. Across depth jumps only pieces of few
/// points are: somebody whom each ring meets once is in no triangle without a corner behind him.
std::vector<std::uint32_t> cluster_objects(const Points& points, const bool* ground,
                                           const ScanMesh& mesh,
                                           const ObjectParameters& parameters);

/// Which points belong to what moves at some time.
///
/// Points that are dynamic by their own votes (more dynamic than static ones) and alone are
/// withdrawn. Objects move as a whole: those that move now, as most of their points say, and those
/// that stand for a while and are seen to leave or to come. Of the former, points stay whose place
/// was always taken: they are of what stands beside and is connected to it. The latter have many
/// static votes, but where nothing ever moves next to none is dynamic; only what is thin collects
/// some, since key frames look past it.
///
/// @param ground, statics, dynamics  one value a point
/// @param first  the sweep's objects
/// @param mesh  of these points
std::vector<std::uint8_t> classify_objects(const Points& points, const bool* ground,
                                           const std::uint32_t* first, const std::uint16_t* statics,
                                           const std::uint16_t* dynamics, const ScanMesh& mesh,
                                           const ObjectParameters& parameters);

/// Loose points, of no object worth the name, inside the extent of one that moves: unless many more
/// votes are static than dynamic, they move, too. `classify_objects` ends with it.
void add_isolated_points(const Points& points, const bool* ground, const std::uint32_t* first,
                         const std::uint16_t* statics, const std::uint16_t* dynamics,
                         const ObjectParameters& parameters, std::vector<std::uint8_t>& moving);

/// Points off the ground inside one of the boxes, where something is on its way, or of the cubes,
/// where sweeps near in time saw what moves: unless many more votes are static than dynamic, they
/// move, too.
///
/// @param boxes, cubes  in the world of T_world_lidar; cubes as `moving_cubes` gives them
void add_points_inside(const Points& points, const bool* ground, const std::uint16_t* statics,
                       const std::uint16_t* dynamics, const Pose& T_world_lidar,
                       const std::vector<Extent>& boxes, const std::vector<std::uint64_t>& cubes,
                       const ObjectParameters& parameters, std::vector<std::uint8_t>& moving);

}  // namespace docdepth
