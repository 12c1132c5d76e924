#include "docdepth/render/motion.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "docdepth/geometry/parallel.hpp"
#include "docdepth/geometry/rigid.hpp"
#include "docdepth/geometry/sampled_points.hpp"

namespace docdepth {
namespace {

using Vector = Eigen::Vector3f;

/// The shift of an object onto another; a score of 0 is no match.
struct Match {
  Vector shift = Vector::Zero();
  float score = 0;
};

Match match(const SampledPoints& a, const SampledPoints& b, float reach) {
  Vector shift = most_frequent_shift(a, b, reach);
  if (!refine_shift(a, b, shift)) return {};
  const float share = matched_share(a, shift, b) * matched_share(b, -shift, a);
  if (share < kMinMatchedShare) return {};
  // Of two equal matches the nearer one is more likely.
  return {shift, share * std::exp(-shift.norm() / (2 * reach))};
}

/// The objects of another sweep in the frame of this one.
std::vector<SampledPoints> transformed(const DynamicObjects& other, const Pose& T_from_to) {
  std::vector<SampledPoints> result = other.samples;
  const RigidTransform T(T_from_to);
  for (auto& samples : result)
    for (auto& p : samples) p = T * p;
  return result;
}

/// At most kReassociationSamples of them, evenly chosen.
SampledPoints subset(const SampledPoints& samples) {
  SampledPoints result;
  for (std::size_t i = 0; i < samples.size(); i += 1 + (samples.size() - 1) / kReassociationSamples)
    result.push_back(samples[i]);
  return result;
}

Vector mean(const SampledPoints& samples) {
  Vector sum = Vector::Zero();
  for (const Vector& p : samples) sum += p;
  return sum / float(samples.size());
}

}  // namespace

std::vector<Box> DynamicObjects::boxes() const {
  std::vector<Box> boxes;
  for (const SampledPoints& object : samples) {
    const Extent whole = extent_of(object);
    boxes.push_back({(whole.low + whole.high) / 2, whole.size() / 2});
  }
  return boxes;
}

DynamicObjects find_dynamic_objects(const Points& points, const std::uint16_t* classid,
                                    const float* time_offset) {
  DynamicObjects objects;
  objects.owner.assign(points.rows(), 0);
  std::unordered_map<std::uint64_t, std::vector<std::uint32_t>> cells;
  const auto cell = [&](std::uint32_t i) {
    return std::pair(voxel_coordinate(points(i, 0), kObjectCell),
                     voxel_coordinate(points(i, 1), kObjectCell));
  };
  for (std::uint32_t i = 0; i < points.rows(); ++i) {
    if (classid[i] < kDynamic) continue;
    const auto [x, y] = cell(i);
    cells[voxel_key(x, y)].push_back(i);
  }
  for (std::uint32_t first = 0; first < points.rows(); ++first) {
    if (classid[first] < kDynamic || objects.owner[first]) continue;
    const auto number = static_cast<std::uint32_t>(objects.samples.size() + 1);
    std::vector<std::uint32_t> members{first};
    objects.owner[first] = number;
    for (std::size_t done = 0; done < members.size(); ++done) {
      const auto [x, y] = cell(members[done]);
      for (int dx = -1; dx <= 1; ++dx)
        for (int dy = -1; dy <= 1; ++dy) {
          const auto near = cells.find(voxel_key(x + dx, y + dy));
          if (near == cells.end()) continue;
          for (const auto i : near->second) {
            objects.owner[i] = number;
            members.push_back(i);
          }
          cells.erase(near);
        }
    }
    SampledPoints all;
    double sum = 0;
    for (std::size_t i = 1; i < members.size(); ++i) {  // the first is in its own cell again
      all.push_back(points.row(members[i]));
      if (time_offset) sum += time_offset[members[i]];
    }
    objects.time_offset.push_back(static_cast<float>(sum / double(all.size())));
    objects.samples.push_back(downsample(all, kSampleSpacing, kMaxObjectSamples));
  }
  return objects;
}

std::vector<Vector> match_velocities(const DynamicObjects& objects, const DynamicObjects& other,
                                     const RelativeMotion& motion, int threads,
                                     const std::vector<std::uint8_t>& wanted) {
  const std::vector<SampledPoints> candidates = transformed(other, motion.T_from_to);
  const float reach = motion.max_speed * std::fabs(motion.duration);
  const std::size_t count = objects.samples.size();
  std::vector<Vector> result(count, Vector::Zero());
  if (!(reach > 0)) return result;
  std::vector<std::vector<Match>> matches(count, std::vector<Match>(candidates.size()));
  parallel_for(count, 1, threads, [&](std::size_t k, std::size_t) {
    const SampledPoints& samples = objects.samples[k];
    if (samples.size() < kMinSamples || (!wanted.empty() && !wanted[k])) return;
    const Vector here = mean(samples);
    for (std::size_t c = 0; c < candidates.size(); ++c)
      if ((mean(candidates[c]) - here).norm() <= reach)
        matches[k][c] = match(samples, candidates[c], reach);
  });
  const auto worse = [](const Match& a, const Match& b) { return a.score < b.score; };
  std::vector<std::size_t> best(candidates.size(), 0);  // the best object of each candidate
  for (std::size_t c = 0; c < candidates.size(); ++c)
    for (std::size_t k = 1; k < count; ++k)
      if (worse(matches[best[c]][c], matches[k][c])) best[c] = k;
  for (std::size_t k = 0; k < count; ++k) {
    auto own = matches[k];
    for (std::size_t c = 0; c < candidates.size(); ++c) {
      const Vector difference = own[c].shift - matches[best[c]][c].shift;
      if (own[c].score > 0 && best[c] != k &&
          matched_share(objects.samples[k], difference, objects.samples[best[c]]) >
              kMaxOccupiedShare)
        own[c].score = 0;
    }
    const auto found = std::max_element(own.begin(), own.end(), worse);
    if (found == own.end() || !(found->score > 0)) continue;
    // The time offsets change the duration a little. If they change it much they are wrong.
    const float later = other.time_offset[found - own.begin()] - objects.time_offset[k];
    const float between = motion.duration + later;
    result[k] = found->shift / (between / motion.duration > 0.5f ? between : motion.duration);
  }
  return result;
}

std::vector<Reassociation> reassociate(const DynamicObjects& objects,
                                       const std::vector<Vector>& velocities,
                                       const DynamicObjects& other, const RelativeMotion& motion) {
  const std::vector<SampledPoints> candidates = transformed(other, motion.T_from_to);
  std::vector<Reassociation> result;
  std::vector<Extent> extents;
  std::vector<SampledPoints> subsets;
  for (std::size_t k = 0; k < velocities.size(); ++k) {
    result.push_back({velocities[k] * motion.duration, {}});
    extents.push_back(extent_of(objects.samples[k]));
    subsets.push_back(subset(objects.samples[k]));
  }
  for (std::size_t c = 0; c < candidates.size(); ++c) {
    const Extent there = extent_of(candidates[c]);
    const SampledPoints subset_there = subset(candidates[c]);
    float most = kMinMatchedShare;
    std::size_t found = velocities.size();
    for (std::size_t k = 0; k < velocities.size(); ++k) {
      const Vector shift =
          velocities[k] * (motion.duration + other.time_offset[c] - objects.time_offset[k]);
      const Extent here{extents[k].low + shift, extents[k].high + shift};
      if (velocities[k].isZero(0) || !here.overlaps(there, 0)) continue;
      const float share = matched_share(subsets[k], shift, candidates[c]) *
                          matched_share(subset_there, -shift, objects.samples[k]);
      if (share > most) most = share, found = k;
    }
    if (found < velocities.size()) result[found].objects.push_back(std::uint32_t(c));
  }
  for (std::size_t k = 0; k < velocities.size(); ++k) {
    SampledPoints there;
    for (const auto c : result[k].objects) {
      const float later = other.time_offset[c] - objects.time_offset[k];
      if (there.empty()) result[k].shift += velocities[k] * later;
      there.insert(there.end(), candidates[c].begin(), candidates[c].end());
    }
    Vector shift = result[k].shift;
    if (refine_shift(subsets[k], there, shift) &&
        (shift - result[k].shift).norm() < kMaxReassociationError)
      result[k].shift = shift;
  }
  return result;
}

}  // namespace docdepth
