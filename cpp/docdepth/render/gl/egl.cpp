#include <array>
#include <cstring>

#include "docdepth/render/gl/platform.hpp"

namespace docdepth::gl {
namespace {

bool contains(const char* extensions, const char* name) {
  if (!extensions) return false;
  const std::size_t length = std::strlen(name);
  for (const char* at = extensions; (at = std::strstr(at, name)); at += length)
    if ((at == extensions || at[-1] == ' ') && (at[length] == ' ' || at[length] == '\0'))
      return true;
  return false;
}

std::string code(int error) {
  constexpr char digits[] = "0123456789ABCDEF";
  std::string text = "0x";
  for (int shift = 12; shift >= 0; shift -= 4) text += digits[(error >> shift) & 15];
  return text;
}

/// libEGL, its entry points and its client extensions.
class Egl {
 public:
  explicit Egl(const std::string& library)
      : library_(library.empty() ? std::vector<std::string>{"libEGL.so.1", "libEGL.so"}
                                 : std::vector<std::string>{library}) {
    library_.find("eglGetProcAddress", f.GetProcAddress);
    library_.find("eglGetError", f.GetError);
    library_.find("eglQueryString", f.QueryString);
    library_.find("eglInitialize", f.Initialize);
    library_.find("eglBindAPI", f.BindAPI);
    library_.find("eglChooseConfig", f.ChooseConfig);
    library_.find("eglCreateContext", f.CreateContext);
    library_.find("eglDestroyContext", f.DestroyContext);
    library_.find("eglCreatePbufferSurface", f.CreatePbufferSurface);
    library_.find("eglDestroySurface", f.DestroySurface);
    library_.find("eglMakeCurrent", f.MakeCurrent);
    extension("eglGetPlatformDisplayEXT", f.GetPlatformDisplayEXT);
    extensions_ = f.QueryString(nullptr, egl::kExtensions);
  }

  void require(const char* name) const {
    if (!contains(extensions_, name)) throw GlError(std::string("EGL here has no ") + name);
  }

  std::vector<void*> devices() {
    if (!contains(extensions_, "EGL_EXT_device_base")) {
      require("EGL_EXT_device_enumeration");
      require("EGL_EXT_device_query");
    }
    extension("eglQueryDevicesEXT", f.QueryDevicesEXT);
    extension("eglQueryDeviceStringEXT", f.QueryDeviceStringEXT);
    int count = 0;
    if (!f.QueryDevicesEXT(0, nullptr, &count) || count < 1) throw GlError("EGL has no device");
    std::vector<void*> found(count);
    f.QueryDevicesEXT(count, found.data(), &count);
    found.resize(count);
    return found;
  }

  bool is_hardware(void* device) const {
    return !contains(f.QueryDeviceStringEXT(device, egl::kExtensions), "EGL_MESA_device_software");
  }

  egl::Functions f{};

 private:
  template <class Function>
  void extension(const char* name, Function& function) const {
    function = reinterpret_cast<Function>(f.GetProcAddress(name));
    if (!function) throw GlError(std::string("EGL here has no ") + name);
  }

  SharedLibrary library_;
  const char* extensions_ = nullptr;
};

class EglPlatform : public Platform {
 public:
  EglPlatform(const Egl& egl, unsigned platform, void* native) : f_(egl.f) {
    // Displays are shared by everyone in the process and thus never terminated.
    display_ = f_.GetPlatformDisplayEXT(platform, native, nullptr);
    if (!display_) fail("eglGetPlatformDisplay");
    if (!f_.Initialize(display_, nullptr, nullptr)) fail("no driver works for it: eglInitialize");
    if (!f_.BindAPI(egl::kOpenGlApi)) fail("eglBindAPI(OpenGL)");
    const char* extensions = f_.QueryString(display_, egl::kExtensions);
    const bool surfaceless = contains(extensions, "EGL_KHR_surfaceless_context");
    void* config = nullptr;
    if (!surfaceless || !contains(extensions, "EGL_KHR_no_config_context")) {
      const std::array<int, 5> wanted{egl::kSurfaceType, surfaceless ? 0 : egl::kPbufferBit,
                                      egl::kRenderableType, egl::kOpenGlBit, egl::kNone};
      int count = 0;
      if (!f_.ChooseConfig(display_, wanted.data(), &config, 1, &count) || !count)
        fail("eglChooseConfig");
    }
    const std::array<int, 7> attributes{
        egl::kMajorVersion,   3,         egl::kMinorVersion, 3, egl::kProfileMask,
        egl::kCoreProfileBit, egl::kNone};
    context_ = f_.CreateContext(display_, config, nullptr, attributes.data());
    if (!context_) fail("eglCreateContext(OpenGL 3.3 core)");
    if (!surfaceless) {
      const std::array<int, 5> size{egl::kWidth, 1, egl::kHeight, 1, egl::kNone};
      surface_ = f_.CreatePbufferSurface(display_, config, size.data());
      if (!surface_) {
        f_.DestroyContext(display_, context_);
        fail("eglCreatePbufferSurface");
      }
    }
  }

  ~EglPlatform() override {
    if (surface_) f_.DestroySurface(display_, surface_);
    f_.DestroyContext(display_, context_);
  }

  bool bind() override {
    // The chosen interface is a property of the thread and may have been changed by others.
    return f_.BindAPI(egl::kOpenGlApi) && f_.MakeCurrent(display_, surface_, surface_, context_);
  }

  void release() override { f_.MakeCurrent(display_, nullptr, nullptr, nullptr); }
  Loader loader() const override { return f_.GetProcAddress; }

 private:
  [[noreturn]] void fail(const char* step) const {
    throw GlError(std::string(step) + " failed with EGL error " + code(f_.GetError()));
  }

  egl::Functions f_;
  void* display_ = nullptr;
  void* context_ = nullptr;
  void* surface_ = nullptr;
};

std::unique_ptr<Platform> open_device(Egl& egl, int wanted) {
  egl.require("EGL_EXT_platform_device");
  const auto devices = egl.devices();
  const int count = static_cast<int>(devices.size());
  if (wanted >= count)
    throw GlError("EGL has no device " + std::to_string(wanted) + ", only 0 to " +
                  std::to_string(count - 1));
  std::string reasons;
  for (const bool hardware : {true, false})
    for (int i = 0; i < count; ++i) {
      if (egl.is_hardware(devices[i]) != hardware || (wanted >= 0 && i != wanted)) continue;
      try {
        return std::make_unique<EglPlatform>(egl, egl::kPlatformDevice, devices[i]);
      } catch (const GlError& error) {
        reasons +=
            (reasons.empty() ? "device " : "; device ") + std::to_string(i) + ": " + error.what();
      }
    }
  throw GlError(reasons);
}

}  // namespace

std::vector<bool> egl_devices(const std::string& library) {
  Egl egl(library);
  std::vector<bool> hardware;
  for (void* device : egl.devices()) hardware.push_back(egl.is_hardware(device));
  return hardware;
}

std::unique_ptr<Platform> open_egl(const Choice& choice) {
  Egl egl(choice.library);
  refuse_after_fork();
  if (choice.backend == Backend::kEgl) return open_device(egl, choice.device);
  egl.require("EGL_MESA_platform_surfaceless");
  return std::make_unique<EglPlatform>(egl, egl::kPlatformSurfaceless, nullptr);
}

}  // namespace docdepth::gl
