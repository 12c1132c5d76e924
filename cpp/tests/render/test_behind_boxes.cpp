#include <doctest/doctest.h>

#include <cmath>
#include <vector>

#include "docdepth/render/behind_boxes.hpp"

using namespace docdepth;

TEST_CASE("rays long before the image look behind a box only if it hardly moved since") {
  // A wall at x = 20 in the frame of the LiDAR, whose rays passed where the box is.
  Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> wall(61 * 41, 3);
  for (int i = 0; i < wall.rows(); ++i)
    wall.row(i) << 20, float(i % 61 - 30) * 0.2f, float(i / 61 - 20) * 0.2f;
  const Points points = wall;
  const std::vector<Eigen::Vector3f> normals(wall.rows(), Eigen::Vector3f(-1, 0, 0));
  const Rays rays(points, normals);
  Pose T_camera_lidar = Pose::Identity();
  T_camera_lidar.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  const Camera camera{50, 50, 10, 10, 21, 21};
  for (const float age : {0.05f, 0.3f})
    for (const float speed : {0.0f, 2.0f, 20.0f}) {
      MeshScene scene;
      scene.shutter_rays = {{&rays, T_camera_lidar, kRayBlur, age}};
      Pose T_camera_box = T_camera_lidar;
      T_camera_box.translation() = T_camera_lidar * Eigen::Vector3d(8, 0, -1);
      scene.boxes = {{T_camera_box, {2, 2, 2}, {0, 0, speed}}};
      std::vector<float> depth(21 * 21, 20.0f);
      mask_unobserved_background(camera, scene, {}, depth, 1);
      const bool looked = age < 0.1f || speed * age < 1;
      CHECK(std::isnan(depth[10 * 21 + 10]) == !looked);
      CHECK(depth[0] == 20.0f);
    }
}
