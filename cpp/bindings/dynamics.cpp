#include "arrays.hpp"

namespace docdepth::bindings {

void bind_dynamics(py::module_&) {}

}  // namespace docdepth::bindings
