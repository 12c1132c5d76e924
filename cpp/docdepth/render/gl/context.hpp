// An OpenGL 3.3 core context without a window, by EGL or OSMesa, loaded at run time.
#pragma once

#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "docdepth/render/gl/api.hpp"

namespace docdepth::gl {

enum class Backend {
  kEgl,          ///< EGL on one of its devices: a GPU, or Mesa's software device
  kSurfaceless,  ///< EGL without a device (EGL_MESA_platform_surfaceless)
  kOsmesa,       ///< Mesa's off-screen library, gone since Mesa 25.1
};

struct Choice {
  Backend backend;
  int device = -1;      ///< of kEgl; -1 takes the first that works, hardware before software
  std::string library;  ///< name of the shared library; empty for the usual ones
};

class Platform;

/// A context belongs to the thread and the process that opened it; in any other its use is an
/// error. Drivers keep threads and locks, which a forked child inherits in an undefined state.
class GlContext {
 public:
  /// @throws GlError saying why the back end cannot be used here
  explicit GlContext(const Choice& choice);
  ~GlContext();
  GlContext(const GlContext&) = delete;
  GlContext& operator=(const GlContext&) = delete;

  const std::string& renderer() const { return renderer_; }  ///< GL_RENDERER
  const std::string& version() const { return version_; }    ///< GL_VERSION
  bool software() const;                                     ///< drawn by the processor

  /// Makes the context current as long as this lives. Afterwards the thread is free for other users
  /// of OpenGL.
  class Current {
   public:
    /// @throws GlError in another thread or process than the one that opened the context
    explicit Current(GlContext& context);
    ~Current();
    Current(const Current&) = delete;
    Current& operator=(const Current&) = delete;
    const Functions* operator->() const { return &context_.functions_; }

   private:
    GlContext& context_;
  };

 private:
  std::unique_ptr<Platform> platform_;
  Functions functions_;
  std::thread::id thread_;
  long process_;
  std::string renderer_, version_;
};

/// Whether each EGL device is hardware. Starts no driver.
/// @throws GlError if there is no EGL, or none that lists devices
std::vector<bool> egl_devices(const std::string& library = "");

}  // namespace docdepth::gl
