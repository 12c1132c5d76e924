#include "arrays.hpp"

namespace docdepth::bindings {

void bind_render(py::module_&) {}

}  // namespace docdepth::bindings
