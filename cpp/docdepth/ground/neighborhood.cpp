#include "docdepth/ground/neighborhood.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "docdepth/geometry/simd.hpp"

namespace docdepth {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
/// Squared distances of n points (whole vectors) to (x, y, z), and the smallest of an open one.
struct Measure {
  DOCDEPTH_KERNEL static void run(const float* xs, const float* ys, const float* zs,
                                  const float* closed, std::size_t n, float x, float y, float z,
                                  float* squared, float* smallest) {
    Floats least = kInfinity - Floats{};
    for (std::size_t i = 0; i < n; i += kLanes) {
      const Floats dx = load(xs + i) - x, dy = load(ys + i) - y, dz = load(zs + i) - z;
      const Floats d = (dx * dx + dy * dy) + dz * dz;
      store(d, squared + i);
      const Floats open = load(closed + i) + d;
      least = open < least ? open : least;
    }
    *smallest = least[0];
    for (int lane = 1; lane < kLanes; ++lane) *smallest = std::min(*smallest, least[lane]);
  }
};

struct CountWithin {
  DOCDEPTH_KERNEL static void run(const float* squared, std::size_t n, float radius,
                                  std::size_t* result) {
    int count = 0;
    for (std::size_t i = 0; i < n; ++i) count += squared[i] <= radius;
    *result = static_cast<std::size_t>(count);
  }
};

std::size_t count_within(const std::vector<float>& squared, std::size_t n, float radius) {
  std::size_t count;
  dispatch<CountWithin>(squared.data(), n, radius, &count);
  return count;
}

/// Sums of the products of offsets from the mean: xx, xy, xz, yy, yz, zz of n points (whole
/// vectors).
struct Spread {
  DOCDEPTH_KERNEL static void run(const double* xs, const double* ys, const double* zs,
                                  std::size_t n, double x, double y, double z, double* sums) {
    Doubles sum[6] = {};
    for (std::size_t i = 0; i < n; i += kDoubleLanes) {
      const Doubles dx = load<Doubles>(xs + i) - x, dy = load<Doubles>(ys + i) - y,
                    dz = load<Doubles>(zs + i) - z;
      sum[0] += dx * dx;
      sum[1] += dx * dy;
      sum[2] += dx * dz;
      sum[3] += dy * dy;
      sum[4] += dy * dz;
      sum[5] += dz * dz;
    }
    for (int k = 0; k < 6; ++k) sums[k] = (sum[k][0] + sum[k][1]) + (sum[k][2] + sum[k][3]);
  }
};

}  // namespace

void Neighborhood::gather(std::uint32_t leaf, double reach) {
  const Octree::Node& node = tree_.nodes()[leaf];
  const Eigen::Vector3d center = node.box.center();
  Eigen::AlignedBox3d box = node.box;
  const Eigen::Vector3d margin = Eigen::Vector3d::Constant(reach * (1.0 + 1e-6));
  box.min() -= margin;
  box.max() += margin;
  const Eigen::Vector3f half = ((0.5 + 1e-6) * box.sizes()).cast<float>();
  reach_ = reach;
  leaves_.clear();
  std::size_t size = 0;
  tree_.visit_leaves(box, [&](std::uint32_t other) {
    leaves_.emplace_back(0, other);
    size += tree_.nodes()[other].end - tree_.nodes()[other].begin;
  });
  reserve(size);
  std::uint32_t n = 0;
  for (auto& [stop, other] : leaves_) {
    const Octree::Node& found = tree_.nodes()[other];
    if (other == leaf) offset_ = node.begin - n;
    for (std::uint32_t i = found.begin; i < found.end; ++i) {
      const Eigen::Vector3f q = (tree_.points()[i] - center).cast<float>();
      index_[n] = i;
      x_[n] = q.x();
      y_[n] = q.y();
      z_[n] = q.z();
      closed_[n] = labels_[i].load(std::memory_order_relaxed) ? kInfinity : 0.f;
      n += (std::fabs(q.x()) <= half.x()) & (std::fabs(q.y()) <= half.y()) &
           (std::fabs(q.z()) <= half.z());
    }
    stop = n;
  }
  // Bound of the rounding of coordinates (2^-24 of the largest), differences and squares.
  error_ = 1e-5f * half.maxCoeff() * half.maxCoeff();
  size_ = n;
  padded_ = (size_ + kLanes - 1) / kLanes * kLanes;
  for (auto* column : {&x_, &y_, &z_, &closed_})
    std::fill(column->begin() + size_, column->begin() + padded_, kInfinity);
}

void Neighborhood::reserve(std::size_t size) {
  size += kLanes;  // padding, and a candidate that is written but not kept
  if (index_.size() >= size) return;
  index_.resize(size);
  nearest_.reserve(size);
  for (auto* column : {&exact_, &dx_, &dy_, &dz_}) column->resize(size);
  for (auto* column : {&x_, &y_, &z_, &closed_, &squared_}) column->resize(size);
}

Neighborhood::Outcome Neighborhood::search(std::uint32_t point, bool always) {
  const std::uint32_t candidate = point - offset_;
  if (size_ < k_) {
    needed_reach_ = 2.0 * reach_;
    return Outcome::kReachTooShort;
  }
  float nearest_open;
  dispatch<Measure>(x_.data(), y_.data(), z_.data(), closed_.data(), padded_, x_[candidate],
                    y_[candidate], z_[candidate], squared_.data(), &nearest_open);
  const auto reach = static_cast<float>(reach_ * reach_);
  const float labelled = std::min(nearest_open, reach) - 4.f * error_;
  if (!always && labelled > 0.f && count_within(squared_, padded_, labelled) >= k_)
    return Outcome::kNothingNew;
  return select(candidate, radius_of_k());
}

/// A squared radius with at least k candidates, and seldom many more.
float Neighborhood::radius_of_k() {
  const auto k = static_cast<float>(k_);
  float low = 0.f, high = kInfinity;
  float radius = guess_ > 0.f ? guess_ : std::max(error_, 1e-6f);
  for (int i = 0; i < 64; ++i) {
    const std::size_t count = count_within(squared_, padded_, radius);
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
  // The k-th distance is at most radius + error, and nearer points look at most error farther.
  const float limit = radius + 2.f * error_;
  nearest_.resize(size_ + 1);
  std::size_t count = 0;
  for (std::uint32_t i = 0; i < size_; ++i) {
    nearest_[count] = i;
    count += squared_[i] <= limit;
  }
  nearest_.resize(count);
  for (std::size_t n = 0; n < count; ++n) {
    const Eigen::Vector3d d = point(nearest_[n]) - point(candidate);
    dx_[n] = d.x();
    dy_[n] = d.y();
    dz_[n] = d.z();
    exact_[n] = (d.x() * d.x() + d.y() * d.y()) + d.z() * d.z();
  }
  sorted_.assign(exact_.begin(), exact_.begin() + count);
  std::nth_element(sorted_.begin(), sorted_.begin() + (k_ - 1), sorted_.end());
  const double last = sorted_[k_ - 1];
  needed_reach_ = std::sqrt(last) * (1.0 + 1e-9);
  if (needed_reach_ > reach_ && size_ < tree_.points().size()) return Outcome::kReachTooShort;
  keep_nearest(last);
  const bool any_open =
      std::any_of(nearest_.begin(), nearest_.end(), [&](std::uint32_t i) { return open(i); });
  return any_open ? Outcome::kFound : Outcome::kNothingNew;
}

/// Keep the k points up to the distance `last`; of several at that distance the first by
/// coordinates.
void Neighborhood::keep_nearest(double last) {
  std::vector<std::uint32_t> equal;
  const auto within = std::count_if(exact_.begin(), exact_.begin() + nearest_.size(),
                                    [&](double squared) { return squared <= last; });
  if (static_cast<std::size_t>(within) > k_) {
    for (std::size_t n = 0; n < nearest_.size(); ++n)
      if (exact_[n] == last) equal.push_back(nearest_[n]);
    std::sort(equal.begin(), equal.end(), [&](std::uint32_t a, std::uint32_t b) {
      return nearer(0.0, point(a), 0.0, point(b));
    });
    equal.erase(equal.begin(), equal.end() - (within - k_));  // these are left out
  }
  std::size_t kept = 0;
  for (std::size_t n = 0; n < nearest_.size(); ++n) {
    nearest_[kept] = nearest_[n];
    dx_[kept] = dx_[n];
    dy_[kept] = dy_[n];
    dz_[kept] = dz_[n];
    kept += exact_[n] <= last &&
            (equal.empty() || std::find(equal.begin(), equal.end(), nearest_[n]) == equal.end());
  }
  nearest_.resize(kept);
}

Eigen::Vector3d Neighborhood::mean() const {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (std::size_t n = 0; n < nearest_.size(); ++n) sum += offset(n);
  return sum / static_cast<double>(nearest_.size());
}

Eigen::Matrix3d Neighborhood::covariance(const Eigen::Vector3d& mean) {
  std::size_t n = nearest_.size();
  for (; n % kDoubleLanes; ++n) {
    dx_[n] = mean.x();
    dy_[n] = mean.y();
    dz_[n] = mean.z();
  }
  double s[6];
  dispatch<Spread>(dx_.data(), dy_.data(), dz_.data(), n, mean.x(), mean.y(), mean.z(), s);
  Eigen::Matrix3d sums;
  sums << s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5];
  return sums;
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
