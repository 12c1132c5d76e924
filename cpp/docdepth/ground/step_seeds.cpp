#include "docdepth/ground/step_seeds.hpp"

#include <cmath>
#include <utility>

#include "docdepth/geometry/parallel.hpp"

namespace docdepth {
namespace {

using Eigen::Vector3d;

/// Behind a step, ground is sought in cells of this edge on the plan [m].
constexpr double kStepCell = 1.0;
/// Behind a gap between rings, ground is as high as before it, but for this [m]. A wall that stands
/// in the gap is hit higher up: with twice as much, cars are ground where a LiDAR has 16 beams.
constexpr double kLevel = 0.1;

}  // namespace

bool StepSeeds::seed(Front& front) {
  count(front);
  const bool any = seed_steps(front);
  return (lidar_ && seed_beyond_gaps(front)) || any;
}

bool StepSeeds::seed_steps(Front& front) {
  using Low = Lows::value_type;
  std::vector<std::pair<double, Low*>> steps;  // height of the ground before each
  std::vector<Low*> unsearched;
  for (const auto& [cell, ground] : cells_) {
    if (!is_half_full(ground)) continue;
    for (int n = 0; n < 9; ++n) {
      const Cell neighbor{cell[0] + n / 3 - 1, cell[1] + n % 3 - 1};
      if (is_full(neighbor)) continue;
      const auto [low, is_new] = lows_.try_emplace(neighbor);
      if (is_new) unsearched.push_back(&*low);
      steps.emplace_back(ground.height(), &*low);
    }
  }
  parallel_for(unsearched.size(), 16, threads_, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      unsearched[i]->second = low_point(unsearched[i]->first);
  });
  bool any = false;
  for (const auto& [height, place] : steps) {
    const std::uint32_t low = place->second;
    if (low == tree_.points().size() || front.labelled(low)) continue;
    if (std::abs(tree_.points()[low].z() - height) > parameters_.step_height) continue;
    front.seed(low);
    any = true;
  }
  return any;
}

bool StepSeeds::seed_beyond_gaps(Front& front) {
  bool any = false;
  const Eigen::Vector2d lidar = (*lidar_ + offset_).head<2>();
  for (const auto& [cell, ground] : cells_) {
    if (!is_half_full(ground)) continue;
    const Eigen::Vector2d middle = kStepCell * (Eigen::Vector2d(double(cell[0]), double(cell[1])) +
                                                Eigen::Vector2d::Constant(0.5));
    const Eigen::Vector2d way = middle - lidar;
    // A gap is shorter than the way to it.
    for (double step = kStepCell; step < way.norm(); step += kStepCell) {
      const Eigen::Vector2d at = (middle + step * way.normalized()) / kStepCell;
      const Cell next{std::int64_t(std::floor(at.x())), std::int64_t(std::floor(at.y()))};
      if (next == cell) continue;
      const auto [low, is_new] = lows_.try_emplace(next);
      if (is_new) low->second = low_point(next);
      if (low->second == tree_.points().size()) continue;
      const double height = tree_.points()[low->second].z();
      if (!is_full(next) && !front.labelled(low->second) &&
          std::abs(height - ground.height()) <= kLevel) {
        front.seed(low->second);
        any = true;
      }
      break;
    }
  }
  return any;
}

bool StepSeeds::is_full(const Cell& cell) const {
  const auto found = cells_.find(cell);
  return found != cells_.end() && found->second.points >= std::size_t(parameters_.neighbors);
}

void StepSeeds::count(const Front& front) {
  Ground* ground = nullptr;
  Cell last{};
  for (std::uint32_t i = 0; i < counted_.size(); ++i) {
    if (counted_[i] || !front.labelled(i)) continue;
    counted_[i] = 1;
    const Vector3d p = tree_.points()[i] + offset_;
    const Cell cell{std::int64_t(std::floor(p.x() / kStepCell)),
                    std::int64_t(std::floor(p.y() / kStepCell))};
    if (!ground || cell != last) ground = &cells_[cell];  // points are sorted along a curve
    last = cell;
    ++ground->points;
    ground->heights += tree_.points()[i].z();
  }
}

std::uint32_t StepSeeds::low_point(const Cell& cell) const {
  const double x = (double(cell[0]) + 0.5) * kStepCell, y = (double(cell[1]) + 0.5) * kStepCell;
  return tree_.quantile(x - offset_.x(), y - offset_.y(), 0.5 * kStepCell,
                        parameters_.seed_quantile);
}

}  // namespace docdepth
