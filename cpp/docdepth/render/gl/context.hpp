// An OpenGL 3.3 core context without a window, by EGL or OSMesa, loaded at run time.
#pragma once

#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>

#include "docdepth/render/gl/api.hpp"

namespace docdepth::gl {

/// A context cannot be opened or used; the message says why.
class GlError : public std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// A context of one of the libraries: how it is made current and how it ends.
struct LibraryContext {
  void (*(*address)(const char* name))() = nullptr;  ///< entry points of OpenGL
  std::function<bool()> bind;
  std::function<void()> release, destroy;
};

/// A context belongs to the thread and the process that opened it; in any other its use is an
/// error. Drivers keep threads and locks, which a forked child inherits in an undefined state.
class GlContext {
 public:
  /// @param library "egl" or "osmesa"
  /// @param device of EGL; -1 takes the first that works, hardware before software
  /// @throws GlError saying why it cannot be used here
  explicit GlContext(const std::string& library, int device = -1);
  ~GlContext();
  GlContext(const GlContext&) = delete;
  GlContext& operator=(const GlContext&) = delete;

  const std::string& renderer() const { return renderer_; }  ///< GL_RENDERER

  /// Makes the context current as long as this lives. Afterwards the thread is free for other users
  /// of OpenGL.
  class Current {
   public:
    /// @throws GlError in another thread or process than the one that opened the context
    explicit Current(GlContext& context);
    ~Current() { context_.context_.release(); }
    Current(const Current&) = delete;
    Current& operator=(const Current&) = delete;
    const Functions* operator->() const { return &context_.functions_; }

   private:
    GlContext& context_;
  };

 private:
  LibraryContext context_;
  Functions functions_;
  std::thread::id thread_;
  long process_;
  std::string renderer_;
};

/// Number of devices that EGL lists; 0 without EGL. Starts no driver.
int egl_devices();

}  // namespace docdepth::gl
