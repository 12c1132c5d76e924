#include <pybind11/pybind11.h>

namespace docdepth::bindings {
void bind_geometry(pybind11::module_& m);
void bind_ground(pybind11::module_& m);
void bind_mesh(pybind11::module_& m);
void bind_voting(pybind11::module_& m);
void bind_objects(pybind11::module_& m);
void bind_render(pybind11::module_& m);
void bind_gl(pybind11::module_& m);

namespace {

/// Refuse `Class.__new__(Class)`: an object without its constructor is memory without a value.
/// Constructors do not look the name up; they are found by the slot of the type.
void refuse_unmade_objects(const pybind11::module_& m) {
  namespace py = pybind11;
  const py::cpp_function refuse([](const py::args&, const py::kwargs&) {
    throw py::type_error("call the class, which makes an object with its arguments");
  });
  const py::object base = py::module_::import("builtins").attr("BaseException");
  for (const auto& [name, member] : m.attr("__dict__").cast<py::dict>()) {
    if (!py::isinstance<py::type>(member) || PyObject_IsSubclass(member.ptr(), base.ptr()))
      continue;
    auto* type = reinterpret_cast<PyTypeObject*>(member.ptr());
    PyDict_SetItemString(type->tp_dict, "__new__", refuse.ptr());
    PyType_Modified(type);
  }
}

}  // namespace
}  // namespace docdepth::bindings

PYBIND11_MODULE(_core, m) {
  m.doc() = "C++ core of docdepth; use the documented functions of docdepth.* instead.";
  m.attr("__version__") = DOCDEPTH_VERSION;
  docdepth::bindings::bind_geometry(m);
  docdepth::bindings::bind_ground(m);
  docdepth::bindings::bind_mesh(m);
  docdepth::bindings::bind_voting(m);
  docdepth::bindings::bind_objects(m);
  docdepth::bindings::bind_render(m);
  docdepth::bindings::bind_gl(m);
  docdepth::bindings::refuse_unmade_objects(m);
}
