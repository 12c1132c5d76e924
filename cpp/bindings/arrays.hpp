// numpy arrays in and out of the core. Their shapes, rows and poses are checked
// here, as what does not fit would be read beyond its end. Parameters are
// checked by config.py.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "docdepth/geometry/types.hpp"
#include "docdepth/mesh/directions.hpp"
#include "docdepth/mesh/scan_mesh.hpp"

namespace docdepth::bindings {

namespace py = pybind11;

// No forcecast: a wrong dtype is an error. Vectors of the compiler need aligned
// values.
template <class T>
using Array =
    py::array_t<T, int(py::array::c_style) | int(py::detail::npy_api::NPY_ARRAY_ALIGNED_)>;

using PointMap = Eigen::Map<const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>>;

constexpr std::int64_t kMaxRows = 0x7fffffff;  ///< rows are numbered by 32 bits
constexpr double kMaxTranslation = 1e8;        ///< of a pose [m]: beyond UTM coordinates
constexpr double kOrthogonal = 1e-3;           ///< of rotations, as in geometry/se3.py

/// @throws std::invalid_argument the number is outside of its range, or not a
/// number
template <class Number>
Number in_range(Number value, double low, double high, const char* name) {
  if (static_cast<double>(value) >= low && static_cast<double>(value) <= high) return value;
  std::ostringstream text;
  text << name << " = " << value << " must lie between " << low << " and " << high;
  throw std::invalid_argument(text.str());
}

/// View of an (N, 3) float32 array, without a copy.
inline PointMap as_points(const Array<float>& array, const char* name = "points") {
  if (array.ndim() != 2 || array.shape(1) != 3 || array.shape(0) > kMaxRows)
    throw std::invalid_argument(std::string(name) + " must be a float32 array of shape (N, 3)");
  return PointMap(array.data(), array.shape(0), 3);
}

/// A pose of 16 values, row after row. Rows and cells of images are computed
/// with it.
inline Pose checked_pose(const double* values) {
  Pose pose;
  pose.matrix() = Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(values);
  const Eigen::Matrix3d gram = pose.linear() * pose.linear().transpose();
  if (!(pose.matrix().allFinite() && pose.matrix().row(3) == Eigen::RowVector4d(0, 0, 0, 1) &&
        (gram - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() < kOrthogonal &&
        pose.linear().determinant() > 0 &&
        pose.translation().cwiseAbs().maxCoeff() < kMaxTranslation))
    throw std::invalid_argument("a pose is not a rotation and a translation in metres");
  return pose;
}

/// A 4x4 row-major float64 array as a pose.
inline Pose as_pose(const Array<double>& array) {
  if (array.ndim() != 2 || array.shape(0) != 4 || array.shape(1) != 4)
    throw std::invalid_argument("a pose must be a float64 array of shape (4, 4)");
  return checked_pose(array.data());
}

/// A (k, 4, 4) row-major float64 array as poses.
inline std::vector<Pose> as_poses(const Array<double>& array) {
  if (array.ndim() != 3 || array.shape(1) != 4 || array.shape(2) != 4)
    throw std::invalid_argument("poses must be a float64 array of shape (k, 4, 4)");
  std::vector<Pose> poses;
  for (py::ssize_t k = 0; k < array.shape(0); ++k)
    poses.push_back(checked_pose(array.data() + 16 * k));
  return poses;
}

/// View of a one-dimensional array of `size` elements, or an error that names
/// it.
template <class T>
const T* as_column(const Array<T>& array, py::ssize_t size, const char* name) {
  if (array.ndim() != 1 || array.shape(0) != size)
    throw std::invalid_argument(std::string(name) + " must have shape (" + std::to_string(size) +
                                ",)");
  return array.data();
}

/// View of one flag per point. Other bytes than 0 and 1 (a view of other
/// integers) are no bool.
inline const bool* as_flags(const Array<bool>& array, py::ssize_t size, const char* name) {
  const bool* flags = as_column(array, size, name);
  const auto* bytes = static_cast<const unsigned char*>(static_cast<const void*>(flags));
  if (std::any_of(bytes, bytes + size, [](unsigned char byte) { return byte > 1; }))
    throw std::invalid_argument(std::string(name) + " must be True or False");
  return flags;
}

/// View of rows of `count` points, or an error that names it.
inline const std::uint32_t* as_rows(const Array<std::uint32_t>& array, py::ssize_t count,
                                    const char* name) {
  std::uint32_t last = 0;  // not left early, so that compilers vectorise it
  for (py::ssize_t i = 0; i < array.size(); ++i) last = std::max(last, array.data()[i]);
  if (array.size() > 0 && last >= count)
    throw std::invalid_argument(std::string(name) + " name a point that is not there");
  return array.data();
}

/// Refuse coordinates that are not finite or too large for any map in single
/// precision.
inline void check_coordinates(const Array<float>& array, const char* name) {
  for (py::ssize_t i = 0; i < array.size(); ++i)
    if (!(std::fabs(array.data()[i]) < kMaxRange))
      throw std::invalid_argument(std::string(name) + " must be finite and below 1e6 m");
}

/// Refuse a mesh of other points, which would read beyond their end.
inline void check_mesh(const ScanMesh& mesh, py::ssize_t rows) {
  if (mesh.points != static_cast<std::size_t>(rows))
    throw std::invalid_argument("the mesh was made of another number of points");
}

/// What some work results in, while other threads of Python go on.
template <class Work>
auto without_gil(const Work& work) {
  const py::gil_scoped_release release;
  return work();
}

/// Hand a vector over to numpy, without a copy; by default as one dimension.
template <class T>
py::array_t<T> to_numpy(std::vector<T>&& values, std::vector<py::ssize_t> shape = {}) {
  if (shape.empty()) shape.push_back(static_cast<py::ssize_t>(values.size()));
  auto* owner = new std::vector<T>(std::move(values));
  py::capsule free(owner, [](void* p) { delete static_cast<std::vector<T>*>(p); });
  return py::array_t<T>(std::move(shape), owner->data(), free);
}

}  // namespace docdepth::bindings
