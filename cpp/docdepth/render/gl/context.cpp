#include "docdepth/render/gl/context.hpp"

#include <unistd.h>

#include <atomic>

#include "docdepth/render/gl/platform.hpp"

namespace docdepth::gl {
namespace {

std::string text(const std::uint8_t* value) {
  return value ? reinterpret_cast<const char*>(value) : "unknown";
}

}  // namespace

void Functions::load(Loader address) {
#define DOCDEPTH_GL_LOAD(result, name, parameters)              \
  name = reinterpret_cast<decltype(name)>(address("gl" #name)); \
  if (!name) throw GlError("the driver has no gl" #name);
  DOCDEPTH_GL_FUNCTIONS(DOCDEPTH_GL_LOAD)
#undef DOCDEPTH_GL_LOAD
}

void refuse_after_fork() {
  static std::atomic<long> first{0};
  const long process = getpid();
  long user = 0;
  if (!first.compare_exchange_strong(user, process) && user != process)
    throw GlError(
        "this process was forked from one that used OpenGL, whose drivers do not survive that; "
        "start workers by spawn or forkserver, or draw by the cpu");
}

GlContext::GlContext(const Choice& choice)
    : platform_(choice.backend == Backend::kOsmesa ? open_osmesa(choice) : open_egl(choice)),
      thread_(std::this_thread::get_id()),
      process_(getpid()) {
  if (!platform_->bind()) throw GlError("the context cannot be made current");
  try {
    functions_.load(platform_->loader());
    renderer_ = text(functions_.GetString(kRenderer));
    version_ = text(functions_.GetString(kVersion));
    int major = 0, minor = 0;
    functions_.GetIntegerv(kMajorVersion, &major);
    functions_.GetIntegerv(kMinorVersion, &minor);
    if (major * 10 + minor < 33)
      throw GlError(renderer_ + " has OpenGL " + version_ + ", 3.3 is needed");
  } catch (...) {
    platform_->release();
    throw;
  }
  platform_->release();
}

GlContext::~GlContext() {
  if (getpid() != process_) static_cast<void>(platform_.release());  // the parent's, not ours
}

bool GlContext::software() const {
  for (const char* name : {"llvmpipe", "softpipe", "swrast", "SwiftShader", "Software Rasterizer"})
    if (renderer_.find(name) != std::string::npos) return true;
  return false;
}

GlContext::Current::Current(GlContext& context) : context_(context) {
  if (getpid() != context.process_)
    throw GlError(
        "this OpenGL context was opened before the process was forked; start workers by spawn or "
        "forkserver, or draw by the cpu");
  if (std::this_thread::get_id() != context.thread_)
    throw GlError("this OpenGL context belongs to another thread; open one in each thread");
  if (!context.platform_->bind()) throw GlError("the context cannot be made current");
}

GlContext::Current::~Current() {
  context_.platform_->release();
}

}  // namespace docdepth::gl
