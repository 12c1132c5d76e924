#include "docdepth/ground/neighborhood.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace docdepth {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr std::size_t kLanes = 8;  // arrays are padded to whole vectors

/// Squared distances of n points (a multiple of kLanes) to (x, y, z), and the smallest of an open
/// one.
float measure(const float* xs, const float* ys, const float* zs, const float* closed, std::size_t n,
              float x, float y, float z, float* squared) {
  float smallest[kLanes];
  std::fill_n(smallest, kLanes, kInfinity);
  for (std::size_t i = 0; i < n; i += kLanes)
    for (std::size_t l = 0; l < kLanes; ++l) {
      const float dx = xs[i + l] - x, dy = ys[i + l] - y, dz = zs[i + l] - z;
      const float d = (dx * dx + dy * dy) + dz * dz;
      squared[i + l] = d;
      const float open = d + closed[i + l];
      smallest[l] = open < smallest[l] ? open : smallest[l];
    }
  return *std::min_element(smallest, smallest + kLanes);
}

std::size_t count_within(const std::vector<float>& squared, float radius) {
  int count = 0;
  for (std::size_t i = 0; i < squared.size(); ++i) count += squared[i] <= radius;
  return static_cast<std::size_t>(count);
}

}  // namespace

void Neighborhood::gather(std::uint32_t leaf, double reach) {
  const Octree::Node& node = tree_.nodes()[leaf];
  const Eigen::Vector3d center = node.box.center();
  Eigen::AlignedBox3d box = node.box;
  const Eigen::Vector3d margin = Eigen::Vector3d::Constant(reach * (1.0 + 1e-6));
  box.min() -= margin;
  box.max() += margin;
  reach_ = reach;
  index_.clear();
  points_.clear();
  leaves_.clear();
  x_.clear();
  y_.clear();
  z_.clear();
  closed_.clear();
  float largest = 0.f;
  tree_.visit_leaves(box, [&](std::uint32_t other) {
    const Octree::Node& found = tree_.nodes()[other];
    if (other == leaf) offset_ = node.begin - static_cast<std::uint32_t>(index_.size());
    for (std::uint32_t i = found.begin; i < found.end; ++i) {
      const Eigen::Vector3d& p = tree_.points()[i];
      if (!box.contains(p)) continue;
      const Eigen::Vector3f q = (p - center).cast<float>();
      index_.push_back(i);
      points_.push_back(p);
      x_.push_back(q.x());
      y_.push_back(q.y());
      z_.push_back(q.z());
      largest = std::max(largest, q.cwiseAbs().maxCoeff());
      closed_.push_back(labels_[i].load(std::memory_order_relaxed) ? kInfinity : 0.f);
    }
    leaves_.emplace_back(static_cast<std::uint32_t>(index_.size()), other);
  });
  // Coordinates are rounded to 2^-24 of the largest, differences and squares as often again.
  error_ = 1e-5f * largest * largest;
  const std::size_t padded = (index_.size() + kLanes - 1) / kLanes * kLanes;
  x_.resize(padded, kInfinity);
  y_.resize(padded, kInfinity);
  z_.resize(padded, kInfinity);
  closed_.resize(padded, kInfinity);
  squared_.resize(padded);
}

Neighborhood::Outcome Neighborhood::search(std::uint32_t point) {
  const std::uint32_t candidate = point - offset_;
  if (index_.size() < k_) {
    needed_reach_ = 2.0 * reach_;
    return Outcome::kReachTooShort;
  }
  const float nearest_open = measure(x_.data(), y_.data(), z_.data(), closed_.data(), x_.size(),
                                     x_[candidate], y_[candidate], z_[candidate], squared_.data());
  const auto reach = static_cast<float>(reach_ * reach_);
  const float labelled = std::min(nearest_open, reach) - 4.f * error_;
  if (labelled > 0.f && count_within(squared_, labelled) >= k_) return Outcome::kNothingNew;
  return select(candidate, radius_of_k());
}

/// A squared radius with at least k candidates, and seldom many more.
float Neighborhood::radius_of_k() {
  const auto k = static_cast<float>(k_);
  float low = 0.f, high = kInfinity;
  float radius = guess_ > 0.f ? guess_ : std::max(error_, 1e-6f);
  for (int i = 0; i < 64; ++i) {
    const std::size_t count = count_within(squared_, radius);
    (count >= k_ ? high : low) = radius;
    if (count >= k_ && (count <= k_ + 6 || i > 6)) break;
    // On a surface the count grows like the squared radius.
    const float next = radius * (k + 3.f) / std::max(1.f, static_cast<float>(count));
    radius = next > low && next < high ? next : high < kInfinity ? 0.5f * (low + high) : 2.f * low;
  }
  guess_ = high;
  return high;
}

Neighborhood::Outcome Neighborhood::select(std::uint32_t candidate, float radius) {
  const Eigen::Vector3d& p = points_[candidate];
  nearest_.clear();
  exact_.clear();
  // The k-th distance is at most radius + error, and who is nearer looks at most error farther.
  const float limit = radius + 2.f * error_;
  for (std::uint32_t i = 0; i < index_.size(); ++i) {
    if (!(squared_[i] <= limit)) continue;
    const Eigen::Vector3d d = points_[i] - p;
    nearest_.push_back(i);
    exact_.push_back((d.x() * d.x() + d.y() * d.y()) + d.z() * d.z());
  }
  sorted_ = exact_;
  std::nth_element(sorted_.begin(), sorted_.begin() + (k_ - 1), sorted_.end());
  const double last = sorted_[k_ - 1];
  needed_reach_ = std::sqrt(last) * (1.0 + 1e-9);
  if (needed_reach_ > reach_ && index_.size() < tree_.points().size())
    return Outcome::kReachTooShort;

  // Of several at the last distance the first by their coordinates.
  std::vector<std::uint32_t> equal;
  std::size_t nearer_ones = 0;
  for (std::size_t i = 0; i < exact_.size(); ++i) {
    nearer_ones += exact_[i] < last;
    if (exact_[i] == last) equal.push_back(nearest_[i]);
  }
  std::sort(equal.begin(), equal.end(), [&](std::uint32_t a, std::uint32_t b) {
    return nearer(0.0, points_[a], 0.0, points_[b]);
  });
  equal.resize(k_ - nearer_ones);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < exact_.size(); ++i)
    if (exact_[i] < last ||
        (exact_[i] == last && std::find(equal.begin(), equal.end(), nearest_[i]) != equal.end()))
      nearest_[kept++] = nearest_[i];
  nearest_.resize(kept);
  const bool any_open =
      std::any_of(nearest_.begin(), nearest_.end(), [&](std::uint32_t i) { return open(i); });
  return any_open ? Outcome::kFound : Outcome::kNothingNew;
}

std::uint32_t Neighborhood::leaf(std::uint32_t candidate) const {
  return std::upper_bound(leaves_.begin(), leaves_.end(), candidate,
                          [](std::uint32_t c, const auto& leaf) { return c < leaf.first; })
      ->second;
}

void Neighborhood::close(std::uint32_t candidate) {
  closed_[candidate] = kInfinity;
}

}  // namespace docdepth
