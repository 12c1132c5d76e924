#include "docdepth/paths/smoothing.hpp"

namespace docdepth {

std::vector<Motion> smooth_positions(const std::vector<MeasuredPosition>& measured,
                                     const std::vector<Eigen::Vector3d>& changes) {
  std::vector<MotionFilter> filtered, predicted;
  MotionFilter filter;
  filter.start({measured.front().time, measured.front().position, Eigen::Matrix3d::Identity()},
               Eigen::Vector3d::Zero(), MotionFilter::kFastest);
  for (std::size_t k = 0; k < measured.size(); ++k) {
    filter.predict(measured[k].time, changes[k]);
    predicted.push_back(filter);
    filter.update(measured[k]);
    filtered.push_back(filter);
  }
  std::vector<Motion> motions(measured.size());
  for (std::size_t k = measured.size(); k-- > 0;) {
    if (k + 1 < measured.size()) filter.smooth(filtered[k], predicted[k + 1]);
    motions[k] = {filter.position(), filter.velocity(), filter.covariance()};
  }
  return motions;
}

}  // namespace docdepth
