// An OpenGL 3.3 core context without a window: EGL or OSMesa, loaded when it is asked for.
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

/// A context belongs to the thread and the process that opened it: drivers keep their own threads
/// and locks, which a forked child gets in whatever state they were. Any other user gets an error.
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

  /// The context is current while this lives, so that other users of OpenGL in the same thread
  /// are not in its way.
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

/// For each device that EGL knows, whether it is more than a software one; starts no driver.
/// @throws GlError if there is no EGL or it cannot tell
std::vector<bool> egl_devices(const std::string& library = "");

}  // namespace docdepth::gl
