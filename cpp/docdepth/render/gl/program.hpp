// Compiling shaders.
#pragma once

#include <vector>

#include "docdepth/render/gl/context.hpp"

namespace docdepth::gl {

/// The kind of a shader, and its source without kExact.
struct Shader {
  unsigned kind;
  const char* source;
};

/// @throws GlError with the message of the driver
unsigned link(const GlContext::Current& gl, const std::vector<Shader>& shaders);

}  // namespace docdepth::gl
