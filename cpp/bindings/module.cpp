#include <pybind11/pybind11.h>

namespace docdepth::bindings {
void bind_ground(pybind11::module_& m);
void bind_surface(pybind11::module_& m);
void bind_dynamics(pybind11::module_& m);
void bind_render(pybind11::module_& m);
void bind_gl(pybind11::module_& m);
}  // namespace docdepth::bindings

PYBIND11_MODULE(_core, m) {
  m.doc() = "C++ core of docdepth; use the documented functions of docdepth.* instead.";
  m.attr("__version__") = DOCDEPTH_VERSION;
  docdepth::bindings::bind_ground(m);
  docdepth::bindings::bind_surface(m);
  docdepth::bindings::bind_dynamics(m);
  docdepth::bindings::bind_render(m);
  docdepth::bindings::bind_gl(m);
}
