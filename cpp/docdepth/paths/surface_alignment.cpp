#include "docdepth/paths/surface_alignment.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "docdepth/detections/quantile.hpp"
#include "docdepth/geometry/point_grid.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;
using Vector4 = Eigen::Vector4d;  // x, y, z, heading
using Matrix4 = Eigen::Matrix4d;

/// Partners are looked for within these distances, step by step [m].
constexpr float kPartnerRadii[] = {0.6f, 0.6f, 0.4f, 0.3f, 0.3f};
/// Where the object moved by more than this between neighbouring measurements [m], normals are
/// fitted to the samples around each one,
constexpr float kMaxBetweenNeighbors = 0.05f;
/// within this radius [m], and to the nearest ones until they are so many,
constexpr float kPlaneRadius = 0.5f;
constexpr std::size_t kMinPlaneSamples = 5;
/// up to this share of the object's horizontal diagonal away: samples of what is long are farther
/// apart.
constexpr float kPlaneShare = 0.11f;
/// Normals are unknown where samples are spread across their plane by more than this share of how
/// they are spread in it, squared.
constexpr float kMaxPlaneThickness = 0.1f;
/// An object ends where its outermost edge is, if it is no farther inside than this [m].
constexpr float kEndMargin = 0.1f;
/// Seen from the side, the ends of an object are known this exactly [m].
constexpr double kEndDeviation = 0.1;
/// Its side is seen if this share of its samples faces there.
constexpr float kMinSideShare = 0.3f;
/// Ends that are farther apart or closer than they should by more than this are those of a piece
/// [m].
constexpr float kMaxLengthError = 0.5f;
/// Where a surface tells nothing: position [m] and heading [rad].
constexpr double kUnknownPosition = 10;
constexpr double kUnknownHeading = 1;

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

/// The ends of a surface along x, where they are seen from the side.
Ends ends_of(const ObservedSurface& seen, const Eigen::Isometry3f& T_object_world) {
  const Eigen::RowVector3f along = T_object_world.linear().row(0),
                           across = T_object_world.linear().row(1);
  std::size_t sideways = 0;
  for (const Vector& normal : seen.normals)
    sideways += std::fabs(across * normal) > 2 * std::fabs(along * normal);
  if (float(sideways) < kMinSideShare * float(seen.points.size())) return {};
  float most[3][2];  // of the surface, its edges, its hidden borders; at the low and the high end
  const SampledPoints* groups[3] = {&seen.points, &seen.edges.points, &seen.hidden.points};
  for (int g = 0; g < 3; ++g) {
    most[g][0] = most[g][1] = -INFINITY;
    for (const Vector& p : *groups[g]) {
      const float x = along * p + T_object_world.translation().x();
      most[g][0] = std::max(most[g][0], -x);
      most[g][1] = std::max(most[g][1], x);
    }
  }
  Ends ends;
  const auto is_seen = [&](int side) {
    return most[1][side] >= most[0][side] - kEndMargin &&
           most[2][side] < std::max(most[0][side], most[1][side]) - 2 * kEndMargin;
  };
  if (is_seen(0)) ends.low = -std::max(most[0][0], most[1][0]);
  if (is_seen(1)) ends.high = std::max(most[0][1], most[1][1]);
  return ends;
}

/// The nearest sample of a model that may be the partner of a point with a normal, of equally near
/// ones the first; the number of samples if none is within a radius.
std::size_t partner_of(const Vector& p, const Vector& facing, const SampledSurface& model,
                       const PointGrid& places, float radius) {
  std::pair<float, std::size_t> nearest{radius * radius, model.points.size()};
  places.any_near(p, radius, [&](const Vector& point, std::size_t index) {
    const std::pair<float, std::size_t> found{(point - p).squaredNorm(), index};
    // Without a normal (zero) a sample is nobody's opposite.
    if (found < nearest && found.first < radius * radius && !(facing.dot(model.normals[index]) < 0))
      nearest = found;
    return false;
  });
  return nearest.second;
}

/// @param places  of the samples of the model
/// @param radius  farther samples are no partners [m]
Equations equations_of(const SampledSurface& seen, const SampledSurface& model,
                       const PointGrid& places, const Eigen::Isometry3f& T_object_world,
                       float radius, const AlignmentOptions& options) {
  Equations sum;
  for (std::size_t i = 0; i < seen.points.size(); ++i) {
    const Vector p = T_object_world * seen.points[i];
    const Vector facing = T_object_world.linear() * seen.normals[i];
    const std::size_t partner = partner_of(p, facing, model, places, radius);
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
    const double weight = plane ? options.point_weight : options.lone_point_weight;
    sum.add({1, 0, 0, -p.y()}, off.x(), weight);
    sum.add({0, 1, 0, p.x()}, off.y(), weight);
  }
  return sum;
}

/// Whether both are of the whole object: a piece of a fence is shorter.
bool have_one_length(const Ends& a, const Ends& b) {
  if (!a.low || !a.high || !b.low || !b.high) return true;
  return std::fabs((*a.high - *a.low) - (*b.high - *b.low)) <= kMaxLengthError;
}

/// The ends of a flat side tell where it is along itself. What looks like an end far from it is
/// that of a piece: another object hides the rest.
void add_ends(const ObservedSurface& seen, const Ends& expected,
              const Eigen::Isometry3f& T_object_world, double residual_deviation, Equations& sum) {
  const Ends found = ends_of(seen, T_object_world);
  if (!have_one_length(found, expected)) return;
  const double weight = (residual_deviation * residual_deviation) / (kEndDeviation * kEndDeviation);
  for (const auto& [end, known] :
       {std::pair(found.low, expected.low), std::pair(found.high, expected.high)})
    if (end && known && std::fabs(*end - *known) <= kMaxLengthError)
      sum.add({1, 0, 0, 0}, *end - *known, weight);
}

/// How far apart in time a sample and its nearest one were measured, in the mean [s].
float time_between_neighbors(const SampledPoints& points, const std::vector<float>& times) {
  float sum = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    float nearest = INFINITY, apart = 0;
    for (std::size_t j = 0; j < points.size(); ++j) {
      const float squared = (points[j] - points[i]).squaredNorm();
      if (j == i || !(squared < nearest)) continue;
      nearest = squared;
      apart = std::fabs(times[j] - times[i]);
    }
    sum += apart;
  }
  return sum / float(points.size());
}

/// Squared radius, up to `most`, around a point within which at least kMinPlaneSamples samples lie.
float plane_radius_squared(const SampledPoints& points, const Vector& point, float most) {
  if (points.size() < kMinPlaneSamples) return kPlaneRadius * kPlaneRadius;
  std::vector<float> squared;
  for (const Vector& other : points) squared.push_back((other - point).squaredNorm());
  const auto last = squared.begin() + kMinPlaneSamples - 1;
  std::nth_element(squared.begin(), last, squared.end());
  return std::clamp(*last, kPlaneRadius * kPlaneRadius, most * most);
}

/// Normals of the planes through the samples around each one, to the side of those that it had.
void fit_normals(SampledSurface& surface) {
  const SampledPoints& points = surface.points;
  const float most = std::max(kPlaneRadius, kPlaneShare * extent_of(points).width());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const float radius_squared = plane_radius_squared(points, points[i], most);
    Vector sum = Vector::Zero();
    Eigen::Matrix3f squares = Eigen::Matrix3f::Zero();
    std::size_t count = 0;
    for (const Vector& point : points) {
      const Vector off = point - points[i];
      if (off.squaredNorm() > radius_squared) continue;
      sum += off;
      squares += off * off.transpose();
      ++count;
    }
    const Vector before = surface.normals[i];
    surface.normals[i].setZero();
    if (count < kMinPlaneSamples) continue;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3f> axes(squares -
                                                              sum * sum.transpose() / float(count));
    if (axes.eigenvalues()[0] > kMaxPlaneThickness * axes.eigenvalues()[1]) continue;
    const Vector normal = axes.eigenvectors().col(0);
    surface.normals[i] = before.dot(normal) < 0 ? Vector(-normal) : normal;
  }
}

}  // namespace

ObservedSurface ObservedSurface::deskewed(const Vector& velocity) const {
  ObservedSurface surface = *this;
  const float speed = velocity.norm();
  const auto [first, last] = std::minmax_element(times.begin(), times.end());
  const auto deskew = [&](SampledPoints& moved, std::vector<float>& late) {
    moved = at_time(moved, late, velocity, 0);
    std::fill(late.begin(), late.end(), 0.0f);
  };
  deskew(surface.points, surface.times);
  // Where a rosette measured neighbours at other times, the mesh of the sweep is not that of what
  // moved meanwhile.
  if (speed * (*last - *first) > kMaxBetweenNeighbors &&
      speed * time_between_neighbors(surface.points, times) > kMaxBetweenNeighbors)
    fit_normals(surface);
  for (TimedPoints* border : {&surface.edges, &surface.hidden})
    deskew(border->points, border->times);
  return surface;
}

void SurfaceModel::add(const ObservedSurface& seen, const Pose& T_world_object) {
  const Eigen::Isometry3f T = T_world_object.inverse().cast<float>();
  ++added_;
  const Ends ends = ends_of(seen, T);
  for (int side : {0, 1})
    if (const auto& end = side ? ends.high : ends.low) ends_[side].push_back(*end);
  for (std::size_t i = 0; i < seen.points.size(); ++i) {
    const Vector p = T * seen.points[i];
    const auto [found, is_new] = numbers_.emplace(voxel_key(p, voxel_), surface_.points.size());
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

Ends SurfaceModel::ends() const {
  Ends ends;
  if (!ends_[0].empty()) ends.low = quantile(ends_[0], 0.5);
  if (!ends_[1].empty()) ends.high = quantile(ends_[1], 0.5);
  return ends;
}

double heading_of(const Pose& T) {
  return std::atan2(T.linear()(1, 0), T.linear()(0, 0));
}

SurfaceAlignment align_surface(const ObservedSurface& seen, const SurfaceModel& model,
                               const ExpectedPose& expected, const AlignmentOptions& options) {
  Pose T_object_world = expected.T_world_object.inverse();
  const Eigen::Matrix3d turn = T_object_world.linear();
  Matrix4 variance = Matrix4::Zero();
  variance.topLeftCorner<3, 3>() = turn * expected.covariance * turn.transpose();
  variance(3, 3) = expected.heading_variance;
  const Matrix4 prior = variance.ldlt().solve(Matrix4::Identity());
  const double information = 1 / (options.residual_deviation * options.residual_deviation);
  Vector4 moved = Vector4::Zero();
  Equations last;
  const Ends model_ends = model.ends();
  const PointGrid places(model.surface().points);
  for (const float radius : kPartnerRadii) {
    const Eigen::Isometry3f T = T_object_world.cast<float>();
    last = equations_of(seen, model.surface(), places, T, radius, options);
    add_ends(seen, model_ends, T, options.residual_deviation, last);
    const Vector4 gradient = information * last.gradient + prior * moved;
    const Vector4 step = -(information * last.hessian + prior).ldlt().solve(gradient);
    moved += step;
    Pose delta = Pose::Identity();
    delta.rotate(Eigen::AngleAxisd(step(3), Eigen::Vector3d::UnitZ()));
    delta.pretranslate(step.head<3>());
    T_object_world = delta * T_object_world;
  }
  // What the surface says alone: the pull of the expectation undone.
  const Vector4 unknown(kUnknownPosition, kUnknownPosition, kUnknownPosition, kUnknownHeading);
  const Matrix4 vague = unknown.cwiseAbs2().cwiseInverse().asDiagonal();
  const Matrix4 covariance = (information * last.hessian + vague).ldlt().solve(Matrix4::Identity());
  const Vector4 further = covariance * (prior - vague) * moved;
  SurfaceAlignment result;
  result.T_world_object = T_object_world.inverse();
  const Eigen::Matrix3d back = result.T_world_object.linear();
  result.position = result.T_world_object * Eigen::Vector3d(-further.head<3>());
  result.covariance = back * covariance.topLeftCorner<3, 3>() * back.transpose();
  result.covariance.diagonal().array() += options.surface_deviation * options.surface_deviation;
  result.heading = heading_of(result.T_world_object) - further(3);
  result.heading_variance = covariance(3, 3);
  result.share = float(last.matched) / float(seen.points.size());
  return result;
}

}  // namespace docdepth
