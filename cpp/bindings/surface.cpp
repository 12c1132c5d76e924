#include "arrays.hpp"

namespace docdepth::bindings {

void bind_surface(py::module_&) {}

}  // namespace docdepth::bindings
