// The rays that passed near each dynamic object of a sweep, as the object saw them.
#pragma once

#include <vector>

#include "docdepth/render/mesh_frame.hpp"

namespace docdepth {

/// For each object the rays that ended on it or passed beside it, each moved with the object from
/// the time of its measurement to the time at which the object is held. So the object stands still
/// among them.
/// @param normals  of the surface at each point
std::vector<Rays> object_rays(const MeshParts& parts, const std::vector<Eigen::Vector3f>& normals);

}  // namespace docdepth
