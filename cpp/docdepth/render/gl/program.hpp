// Shaders to programs.
#pragma once

#include <vector>

#include "docdepth/render/gl/context.hpp"

namespace docdepth::gl {

/// A shader of each kind and its source, which comes behind kExact.
struct Shader {
  unsigned kind;
  const char* source;
};

/// @throws GlError with the driver's words
unsigned link(const GlContext::Current& gl, const std::vector<Shader>& shaders);

}  // namespace docdepth::gl
