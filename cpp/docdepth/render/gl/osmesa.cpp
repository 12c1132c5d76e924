#include <array>

#include "docdepth/render/gl/platform.hpp"

namespace docdepth::gl {
namespace {

class OsmesaPlatform : public Platform {
 public:
  explicit OsmesaPlatform(const SharedLibrary& library) {
    library.find("OSMesaGetProcAddress", f_.GetProcAddress);
    library.find("OSMesaCreateContextAttribs", f_.CreateContextAttribs);
    library.find("OSMesaDestroyContext", f_.DestroyContext);
    library.find("OSMesaMakeCurrent", f_.MakeCurrent);
    const std::array<int, 11> attributes{osmesa::kFormat,
                                         kRgba,
                                         osmesa::kDepthBits,
                                         0,
                                         osmesa::kProfile,
                                         osmesa::kCoreProfile,
                                         osmesa::kMajorVersion,
                                         3,
                                         osmesa::kMinorVersion,
                                         3,
                                         0};
    context_ = f_.CreateContextAttribs(attributes.data(), nullptr);
    if (!context_) throw GlError("OSMesa gives no OpenGL 3.3 core context");
  }

  ~OsmesaPlatform() override { f_.DestroyContext(context_); }

  bool bind() override { return f_.MakeCurrent(context_, pixel_.data(), kUnsignedByte, 1, 1); }

  void release() override { f_.MakeCurrent(nullptr, nullptr, 0, 0, 0); }
  Loader loader() const override { return f_.GetProcAddress; }

 private:
  osmesa::Functions f_{};
  void* context_ = nullptr;
  std::array<std::uint8_t, 4> pixel_{};  // its own frame buffer, which nothing is drawn into
};

}  // namespace

std::unique_ptr<Platform> open_osmesa(const Choice& choice) {
  const std::vector<std::string> usual{"libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"};
  const SharedLibrary library(choice.library.empty() ? usual
                                                     : std::vector<std::string>{choice.library});
  refuse_after_fork();
  return std::make_unique<OsmesaPlatform>(library);
}

}  // namespace docdepth::gl
