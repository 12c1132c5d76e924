// What the bindings of detections and of tracks share.
#pragma once

#include <array>
#include <cstdint>

#include "arrays.hpp"
#include "docdepth/detections/detections.hpp"

PYBIND11_MAKE_OPAQUE(docdepth::Detections)

namespace docdepth::bindings {

/// A box around an object, as a row of a structured array.
struct BoxRow {
  std::uint32_t track, is_moving;
  float T_box_world[3][4];
  std::array<float, 3> half_size;
};

using Rows3x4 = Eigen::Matrix<float, 3, 4, Eigen::RowMajor>;

inline std::array<float, 3> as_array(const Eigen::Vector3f& v) {
  return {v.x(), v.y(), v.z()};
}

}  // namespace docdepth::bindings
