#include "docdepth/render/gl/platform.hpp"

#if defined(__linux__)
#include <dlfcn.h>
#endif

namespace docdepth::gl {

#if defined(__linux__)

SharedLibrary::SharedLibrary(const std::vector<std::string>& names) : handle_(nullptr) {
  std::string reasons;
  for (const auto& name : names) {
    handle_ = dlopen(name.c_str(), RTLD_LAZY | RTLD_LOCAL);
    if (handle_) {
      name_ = name;
      return;
    }
    const char* reason = dlerror();
    reasons += (reasons.empty() ? "" : "; ") + std::string(reason ? reason : name);
  }
  throw GlError(reasons);
}

void* SharedLibrary::address(const char* name) const {
  void* found = dlsym(handle_, name);
  if (!found) throw GlError(name_ + " has no " + name);
  return found;
}

#else

SharedLibrary::SharedLibrary(const std::vector<std::string>&) : handle_(nullptr) {
  throw GlError("scene by OpenGL without a window is implemented for Linux only");
}

void* SharedLibrary::address(const char*) const {
  return handle_;
}

#endif

}  // namespace docdepth::gl
