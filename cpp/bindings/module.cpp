#include <pybind11/pybind11.h>

namespace docdepth::bindings {
void bind_geometry(pybind11::module_& m);
void bind_ground(pybind11::module_& m);
void bind_mesh(pybind11::module_& m);
void bind_odometry(pybind11::module_& m);
void bind_voting(pybind11::module_& m);
void bind_objects(pybind11::module_& m);
void bind_tracks(pybind11::module_& m);
void bind_render(pybind11::module_& m);
void bind_occupancy(pybind11::module_& m);
}  // namespace docdepth::bindings

PYBIND11_MODULE(_core, m) {
  m.doc() =
      "C++ core of docdepth; use the documented functions of docdepth.* "
      "instead.";
  m.attr("__version__") = DOCDEPTH_VERSION;
  docdepth::bindings::bind_geometry(m);
  docdepth::bindings::bind_ground(m);
  docdepth::bindings::bind_mesh(m);
  docdepth::bindings::bind_odometry(m);
  docdepth::bindings::bind_voting(m);
  docdepth::bindings::bind_objects(m);
  docdepth::bindings::bind_tracks(m);
  docdepth::bindings::bind_render(m);
  docdepth::bindings::bind_occupancy(m);
}
