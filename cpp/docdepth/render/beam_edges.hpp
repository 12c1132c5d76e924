// Beams are wider than a line: where things end that were seen by them.
#pragma once

#include <cstddef>
#include <cstdint>

#include "docdepth/geometry/types.hpp"

namespace docdepth {

/// The returns of a sweep as beams without width would have seen them.
///
/// A beam whose edge touches a thing returns from it, so things are seen wider than they are, by
/// a part of a beam on each side. At each depth jump the last return of the nearer surface and the
/// first one of the farther surface are turned towards the nearer surface, by that angle and at
/// most by half of the angle between them. A return that is alone between two jumps stays.
/// @param triangles      of the scan mesh
/// @param discontinuity  1 for each triangle across a depth jump
/// @param widening       by which a thing is seen too wide on each side [rad]
Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> narrow_beams(
    const Points& points, const std::uint32_t (*triangles)[3], const std::uint8_t* discontinuity,
    std::size_t triangle_count, float widening);

}  // namespace docdepth
