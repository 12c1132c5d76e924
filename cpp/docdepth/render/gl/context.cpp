#include "docdepth/render/gl/context.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <vector>

#if defined(__linux__)
#include <dlfcn.h>
#endif

namespace docdepth::gl {
namespace {

/// A shared library. It stays loaded until the process ends: drivers do not survive unloading.
class Library {
 public:
  /// The first of `names` that loads. @throws GlError with the loader's words for each
  explicit Library(const std::vector<std::string>& names);

  /// @throws GlError the library has no such function
  template <class Function>
  void find(const char* function, Function& pointer) const {
    pointer = reinterpret_cast<Function>(address(function));
    if (!pointer) throw GlError(name_ + " has no " + function);
  }

 private:
  void* address(const char* function) const;

  void* handle_ = nullptr;
  std::string name_;
};

#if defined(__linux__)

Library::Library(const std::vector<std::string>& names) {
  std::string reasons;
  for (const auto& name : names) {
    handle_ = dlopen(name.c_str(), RTLD_LAZY | RTLD_LOCAL);
    name_ = name;
    if (handle_) return;
    const char* reason = dlerror();
    reasons += (reasons.empty() ? "" : "; ") + std::string(reason ? reason : name);
  }
  throw GlError(reasons);
}

void* Library::address(const char* function) const {
  return dlsym(handle_, function);
}

#else

Library::Library(const std::vector<std::string>&) {
  throw GlError("OpenGL without a window is implemented for Linux only");
}

void* Library::address(const char*) const {
  return handle_;
}

#endif

/// @throws GlError this process was forked after its parent had started a driver
void refuse_after_fork() {
  static std::atomic<long> first{0};
  const long process = getpid();
  long user = 0;
  if (!first.compare_exchange_strong(user, process) && user != process)
    throw GlError(
        "this process was forked from one that used OpenGL, whose drivers do not survive that; "
        "start workers by spawn or forkserver, or draw by the cpu");
}

// --- EGL ---

enum : int {
  kEglNone = 0x3038,
  kEglExtensions = 0x3055,
  kEglMajorVersion = 0x3098,
  kEglOpenGlApi = 0x30A2,
  kEglMinorVersion = 0x30FB,
  kEglProfileMask = 0x30FD,
  kEglCoreProfileBit = 0x0001,
  kEglPlatformDevice = 0x313F,
  kEglPlatformSurfaceless = 0x31DD,
};

/// Whether a list of extensions, which may be null, has one.
bool has(const char* extensions, const char* name) {
  const std::string all = std::string(" ") + (extensions ? extensions : "") + " ";
  return all.find(std::string(" ") + name + " ") != std::string::npos;
}

/// Entry points of libEGL. Those of extensions are null where they are missing.
struct Egl {
  void (*(*address)(const char*))();
  int (*error)();
  const char* (*query)(void* display, int name);
  unsigned (*initialize)(void* display, int* major, int* minor);
  unsigned (*bind_api)(unsigned api);
  void* (*create_context)(void* display, void* config, void* share, const int* attributes);
  unsigned (*destroy_context)(void* display, void* context);
  unsigned (*make_current)(void* display, void* draw, void* read, void* context);
  void* (*display_of)(unsigned platform, void* native, const int* attributes);
  unsigned (*devices)(int capacity, void** devices, int* count);
  const char* (*query_device)(void* device, int name);

  Egl() {
    const Library library({"libEGL.so.1", "libEGL.so"});
    library.find("eglGetProcAddress", address);
    library.find("eglGetError", error);
    library.find("eglQueryString", query);
    library.find("eglInitialize", initialize);
    library.find("eglBindAPI", bind_api);
    library.find("eglCreateContext", create_context);
    library.find("eglDestroyContext", destroy_context);
    library.find("eglMakeCurrent", make_current);
    extension("eglGetPlatformDisplayEXT", display_of);
    extension("eglQueryDevicesEXT", devices);
    extension("eglQueryDeviceStringEXT", query_device);
  }

  /// What a context can be opened on: devices, the hardware among them first, then no device.
  struct Candidate {
    unsigned platform;
    void* native;
    std::string name;
  };

  std::vector<void*> listed() const {
    const char* all = query(nullptr, kEglExtensions);
    int count = 0;
    if (!has(all, "EGL_EXT_platform_device") || !display_of || !devices || !query_device ||
        !devices(0, nullptr, &count))
      return {};
    std::vector<void*> found(count);
    devices(count, found.data(), &count);
    found.resize(count);
    return found;
  }

  std::vector<Candidate> candidates(int wanted) const {
    const std::vector<void*> all = listed();
    if (wanted >= int(all.size()))
      throw GlError("EGL has no device " + std::to_string(wanted) + "; it lists " +
                    std::to_string(all.size()));
    std::vector<Candidate> found;
    for (std::size_t i = 0; i < all.size(); ++i)
      if (wanted < 0 || wanted == int(i))
        found.push_back({kEglPlatformDevice, all[i], "device " + std::to_string(i)});
    std::stable_partition(found.begin(), found.end(), [&](const Candidate& one) {
      return !has(query_device(one.native, kEglExtensions), "EGL_MESA_device_software");
    });
    if (wanted < 0 && display_of &&
        has(query(nullptr, kEglExtensions), "EGL_MESA_platform_surfaceless"))
      found.push_back({kEglPlatformSurfaceless, nullptr, "no device"});
    return found;
  }

  LibraryContext open(const Candidate& on) const {
    // Displays are shared by everyone in the process and thus never terminated.
    void* display = display_of(on.platform, on.native, nullptr);
    if (!display) fail("eglGetPlatformDisplay");
    if (!initialize(display, nullptr, nullptr)) fail("no driver works for it: eglInitialize");
    if (!bind_api(kEglOpenGlApi)) fail("eglBindAPI(OpenGL)");
    for (const char* name : {"EGL_KHR_surfaceless_context", "EGL_KHR_no_config_context"})
      if (!has(query(display, kEglExtensions), name))
        throw GlError(std::string("the driver has no ") + name);
    const std::array<int, 7> attributes{
        kEglMajorVersion, 3, kEglMinorVersion, 3, kEglProfileMask, kEglCoreProfileBit, kEglNone};
    void* context = create_context(display, nullptr, nullptr, attributes.data());
    if (!context) fail("eglCreateContext(OpenGL 3.3 core)");
    // The chosen interface is a property of the thread and may have been changed by others.
    const auto bind = [egl = *this, display, context] {
      return egl.bind_api(kEglOpenGlApi) && egl.make_current(display, nullptr, nullptr, context);
    };
    const auto release = [egl = *this, display] {
      egl.make_current(display, nullptr, nullptr, nullptr);
    };
    const auto destroy = [egl = *this, display, context] { egl.destroy_context(display, context); };
    return {address, bind, release, destroy};
  }

 private:
  template <class Function>
  void extension(const char* name, Function& pointer) const {
    pointer = reinterpret_cast<Function>(address(name));
  }

  [[noreturn]] void fail(const char* step) const {
    constexpr char digits[] = "0123456789ABCDEF";
    const int code = error();
    std::string text = std::string(step) + " failed with EGL error 0x";
    for (int shift = 12; shift >= 0; shift -= 4) text += digits[(code >> shift) & 15];
    throw GlError(text);
  }
};

LibraryContext open_egl(int device) {
  const Egl egl;
  refuse_after_fork();
  std::string reasons;
  for (const auto& candidate : egl.candidates(device)) {
    try {
      return egl.open(candidate);
    } catch (const GlError& error) {
      reasons += (reasons.empty() ? "" : "; ") + candidate.name + ": " + error.what();
    }
  }
  throw GlError(reasons.empty() ? "EGL here opens no context without a window" : reasons);
}

// --- OSMesa ---

enum : int {
  kOsmesaFormat = 0x22,
  kOsmesaRgba = 0x1908,
  kOsmesaDepthBits = 0x30,
  kOsmesaProfile = 0x33,
  kOsmesaCoreProfile = 0x34,
  kOsmesaMajorVersion = 0x36,
  kOsmesaMinorVersion = 0x37,
};

LibraryContext open_osmesa() {
  void (*(*address)(const char*))();
  void* (*create)(const int* attributes, void* share);
  void (*destroy)(void* context);
  std::uint8_t (*make_current)(void* context, void* pixels, unsigned type, int width, int height);
  const Library library({"libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"});
  library.find("OSMesaGetProcAddress", address);
  library.find("OSMesaCreateContextAttribs", create);
  library.find("OSMesaDestroyContext", destroy);
  library.find("OSMesaMakeCurrent", make_current);
  refuse_after_fork();
  const std::array<int, 11> attributes{kOsmesaFormat,
                                       kOsmesaRgba,
                                       kOsmesaDepthBits,
                                       0,
                                       kOsmesaProfile,
                                       kOsmesaCoreProfile,
                                       kOsmesaMajorVersion,
                                       3,
                                       kOsmesaMinorVersion,
                                       3,
                                       0};
  void* context = create(attributes.data(), nullptr);
  if (!context) throw GlError("OSMesa gives no OpenGL 3.3 core context");
  // Its own frame buffer of one pixel, which nothing is drawn into.
  const auto pixel = std::make_shared<std::array<std::uint8_t, 4>>();
  return {address, [=] { return make_current(context, pixel->data(), kUnsignedByte, 1, 1) != 0; },
          [=] { make_current(nullptr, nullptr, 0, 0, 0); }, [=] { destroy(context); }};
}

}  // namespace

GlContext::GlContext(const std::string& library, int device)
    : context_(library == "osmesa" ? open_osmesa() : open_egl(device)),
      thread_(std::this_thread::get_id()),
      process_(getpid()) {
  try {
    if (!context_.bind()) throw GlError("the context cannot be made current");
#define DOCDEPTH_GL_LOAD(result, name, parameters)                                             \
  functions_.name = reinterpret_cast<decltype(functions_.name)>(context_.address("gl" #name)); \
  if (!functions_.name) throw GlError("the driver has no gl" #name);
    DOCDEPTH_GL_FUNCTIONS(DOCDEPTH_GL_LOAD)
#undef DOCDEPTH_GL_LOAD
    const auto* name = reinterpret_cast<const char*>(functions_.GetString(kRenderer));
    renderer_ = name ? name : "unknown";
    int major = 0, minor = 0;
    functions_.GetIntegerv(kMajorVersion, &major);
    functions_.GetIntegerv(kMinorVersion, &minor);
    if (major * 10 + minor < 33)
      throw GlError(renderer_ + " has OpenGL " + std::to_string(major) + "." +
                    std::to_string(minor) + ", 3.3 is needed");
  } catch (...) {
    context_.release();
    context_.destroy();
    throw;
  }
  context_.release();
}

GlContext::~GlContext() {
  if (getpid() == process_) context_.destroy();  // else it is the parent's
}

GlContext::Current::Current(GlContext& context) : context_(context) {
  if (getpid() != context.process_)
    throw GlError(
        "this OpenGL context was opened before the process was forked; start workers by spawn or "
        "forkserver, or draw by the cpu");
  if (std::this_thread::get_id() != context.thread_)
    throw GlError("this OpenGL context belongs to another thread; open one in each thread");
  if (!context.context_.bind()) throw GlError("the context cannot be made current");
}

int egl_devices() {
  try {
    return static_cast<int>(Egl().listed().size());
  } catch (const GlError&) {
    return 0;
  }
}

}  // namespace docdepth::gl
