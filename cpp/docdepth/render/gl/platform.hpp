// The libraries behind a context, each loaded at run time.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "docdepth/render/gl/api.hpp"
#include "docdepth/render/gl/context.hpp"

namespace docdepth::gl {

/// A shared library. It stays loaded until the process ends, since drivers do not survive
/// unloading.
class SharedLibrary {
 public:
  /// The first of `names` that loads. @throws GlError with the loader's words for each
  explicit SharedLibrary(const std::vector<std::string>& names);

  /// @throws GlError if the library has no such function
  template <class Function>
  void find(const char* name, Function& function) const {
    function = reinterpret_cast<Function>(address(name));
  }

 private:
  void* address(const char* name) const;

  void* handle_;
  std::string name_;
};

/// A library that can make a context current.
class Platform {
 public:
  virtual ~Platform() = default;
  virtual bool bind() = 0;     ///< make current in the calling thread
  virtual void release() = 0;  ///< make nothing current
  virtual Loader loader() const = 0;
};

std::unique_ptr<Platform> open_egl(const Choice& choice);
std::unique_ptr<Platform> open_osmesa(const Choice& choice);

/// @throws GlError if this process was forked after its parent had started a driver
void refuse_after_fork();

}  // namespace docdepth::gl
