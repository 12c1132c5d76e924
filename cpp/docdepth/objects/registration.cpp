#include "docdepth/objects/registration.hpp"

#include <Eigen/Cholesky>
#include <cmath>

#include "docdepth/objects/constants.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Vector4 = Eigen::Vector4d;  // x, y, z, heading
using Matrix4 = Eigen::Matrix4d;

/// Normal equations of the residuals of one step.
struct Equations {
  Matrix4 hessian = Matrix4::Zero();
  Vector4 gradient = Vector4::Zero();
  std::size_t matched = 0;

  void add(const Vector4& slope, double residual, double weight) {
    hessian += weight * slope * slope.transpose();
    gradient += weight * residual * slope;
  }
};

/// @param radius  farther samples are no partners [m]
Equations equations_of(const SampledSurface& seen, const SampledSurface& model,
                       const Eigen::Isometry3f& T_object_world, float radius) {
  Equations sum;
  for (std::size_t i = 0; i < seen.points.size(); ++i) {
    const Vector p = T_object_world * seen.points[i];
    const Vector facing = T_object_world.linear() * seen.normals[i];
    float nearest = radius * radius;
    std::size_t partner = model.points.size();
    for (std::size_t j = 0; j < model.points.size(); ++j) {
      const float squared = (model.points[j] - p).squaredNorm();
      if (!(squared < nearest)) continue;
      // Without a normal (zero) a sample is nobody's opposite.
      if (facing.dot(model.normals[j]) < 0) continue;
      nearest = squared, partner = j;
    }
    if (partner == model.points.size()) continue;
    ++sum.matched;
    const Vector off = p - model.points[partner];
    Vector normal = model.normals[partner] + facing;
    const bool plane = !model.normals[partner].isZero(0) && !facing.isZero(0);
    if (plane) {
      normal.normalize();
      const Vector4 slope(normal.x(), normal.y(), normal.z(),
                          normal.y() * p.x() - normal.x() * p.y());
      sum.add(slope, normal.dot(off), 1);
    }
    // Rings stay where they are while the object moves, so only horizontal distances tell.
    const double weight = plane ? kPointWeight : kLonePointWeight;
    sum.add({1, 0, 0, -p.y()}, off.x(), weight);
    sum.add({0, 1, 0, p.x()}, off.y(), weight);
  }
  return sum;
}

}  // namespace

void SurfaceModel::add(const SampledSurface& seen, const Pose& T_world_object) {
  const Eigen::Isometry3f T = T_world_object.inverse().cast<float>();
  ++added_;
  for (std::size_t i = 0; i < seen.points.size(); ++i) {
    const Vector p = T * seen.points[i];
    const auto key = voxel_key(voxel_coordinate(p.x(), voxel_), voxel_coordinate(p.y(), voxel_),
                               voxel_coordinate(p.z(), voxel_));
    const auto [found, is_new] = numbers_.emplace(key, surface_.points.size());
    if (is_new) {
      surface_.points.push_back(p);
      surface_.normals.push_back(T.linear() * seen.normals[i]);
      hits_.push_back(1);
      last_.push_back(added_);
    } else if (last_[found->second] != added_) {
      ++hits_[found->second];
      last_[found->second] = added_;
    }
  }
}

Registration register_surface(const SampledSurface& seen, const SurfaceModel& model,
                              const Pose& guess) {
  Pose T_object_world = guess.inverse();
  const Vector4 deviation(kGuessDeviation, kGuessDeviation, kGuessDeviation,
                          kGuessHeadingDeviation);
  const Matrix4 prior = deviation.cwiseAbs2().cwiseInverse().asDiagonal();
  const double information = 1 / (kResidualDeviation * kResidualDeviation);
  Vector4 moved = Vector4::Zero();
  Equations last;
  for (const float radius : kRegistrationRadii) {
    last = equations_of(seen, model.surface(), T_object_world.cast<float>(), radius);
    const Vector4 gradient = information * last.gradient + prior * moved;
    const Vector4 step = -(information * last.hessian + prior).ldlt().solve(gradient);
    moved += step;
    Pose delta = Pose::Identity();
    delta.rotate(Eigen::AngleAxisd(step(3), Eigen::Vector3d::UnitZ()));
    delta.pretranslate(step.head<3>());
    T_object_world = delta * T_object_world;
  }
  const Matrix4 covariance =
      (information * last.hessian + prior).ldlt().solve(Matrix4::Identity());
  Registration result;
  result.T_world_object = T_object_world.inverse();
  const Eigen::Matrix3d turn = result.T_world_object.linear();
  result.covariance = turn * covariance.topLeftCorner<3, 3>() * turn.transpose();
  result.covariance.diagonal().array() += kSurfaceDeviation * kSurfaceDeviation;
  result.heading_variance = covariance(3, 3);
  result.share = float(last.matched) / float(seen.points.size());
  return result;
}

}  // namespace docdepth
