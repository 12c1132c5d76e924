#include "arrays.hpp"

namespace docdepth::bindings {

void bind_ground(py::module_&) {}

}  // namespace docdepth::bindings
