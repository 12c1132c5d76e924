// The parts of OpenGL 3.3 core that the renderer uses. They are declared here, so that no headers
// are needed to build and no library to run.
#pragma once

#include <cstddef>
#include <cstdint>

namespace docdepth::gl {

// X(return type, name without "gl", parameters)
#define DOCDEPTH_GL_FUNCTIONS(X)                                                              \
  X(const std::uint8_t*, GetString, (unsigned name))                                          \
  X(void, GetIntegerv, (unsigned name, int* value))                                           \
  X(unsigned, GetError, ())                                                                   \
  X(void, Finish, ())                                                                         \
  X(unsigned, CreateShader, (unsigned type))                                                  \
  X(void, ShaderSource, (unsigned shader, int count, const char* const*, const int* lengths)) \
  X(void, CompileShader, (unsigned shader))                                                   \
  X(void, DeleteShader, (unsigned shader))                                                    \
  X(unsigned, CreateProgram, ())                                                              \
  X(void, AttachShader, (unsigned program, unsigned shader))                                  \
  X(void, LinkProgram, (unsigned program))                                                    \
  X(void, GetProgramiv, (unsigned program, unsigned name, int* value))                        \
  X(void, GetProgramInfoLog, (unsigned program, int capacity, int* length, char* log))        \
  X(void, UseProgram, (unsigned program))                                                     \
  X(int, GetUniformLocation, (unsigned program, const char* name))                            \
  X(void, Uniform1i, (int location, int value))                                               \
  X(void, Uniform2f, (int location, float, float))                                            \
  X(void, Uniform1fv, (int location, int count, const float* values))                         \
  X(void, Uniform4fv, (int location, int count, const float* values))                         \
  X(void, GenVertexArrays, (int count, unsigned* names))                                      \
  X(void, BindVertexArray, (unsigned name))                                                   \
  X(void, EnableVertexAttribArray, (unsigned index))                                          \
  X(void, VertexAttribPointer,                                                                \
    (unsigned index, int size, unsigned type, std::uint8_t normalized, int stride,            \
     const void* offset))                                                                     \
  X(void, GenBuffers, (int count, unsigned* names))                                           \
  X(void, DeleteBuffers, (int count, const unsigned* names))                                  \
  X(void, BindBuffer, (unsigned target, unsigned name))                                       \
  X(void, BufferData, (unsigned target, std::ptrdiff_t bytes, const void*, unsigned usage))   \
  X(void, BufferSubData,                                                                      \
    (unsigned target, std::ptrdiff_t offset, std::ptrdiff_t bytes, const void* data))         \
  X(void, GenFramebuffers, (int count, unsigned* names))                                      \
  X(void, BindFramebuffer, (unsigned target, unsigned name))                                  \
  X(void, GenRenderbuffers, (int count, unsigned* names))                                     \
  X(void, BindRenderbuffer, (unsigned target, unsigned name))                                 \
  X(void, RenderbufferStorage, (unsigned target, unsigned format, int width, int height))     \
  X(void, FramebufferRenderbuffer,                                                            \
    (unsigned target, unsigned attachment, unsigned renderbuffer_target, unsigned name))      \
  X(unsigned, CheckFramebufferStatus, (unsigned target))                                      \
  X(void, Viewport, (int x, int y, int width, int height))                                    \
  X(void, Enable, (unsigned capability))                                                      \
  X(void, BlendEquation, (unsigned mode))                                                     \
  X(void, ClearBufferfv, (unsigned buffer, int index, const float* value))                    \
  X(void, MultiDrawArrays, (unsigned mode, const int* first, const int* count, int draws))    \
  X(void, MultiDrawElementsBaseVertex,                                                        \
    (unsigned mode, const int* count, unsigned type, const void* const* offsets, int draws,   \
     const int* base))                                                                        \
  X(void, ReadPixels,                                                                         \
    (int x, int y, int width, int height, unsigned format, unsigned type, void* pixels))

/// The entry points of one context.
struct Functions {
#define DOCDEPTH_GL_MEMBER(result, name, parameters) result(*name) parameters = nullptr;
  DOCDEPTH_GL_FUNCTIONS(DOCDEPTH_GL_MEMBER)
#undef DOCDEPTH_GL_MEMBER
};

enum : unsigned {
  kPoints = 0x0000,
  kTriangles = 0x0004,
  kOutOfMemory = 0x0505,
  kBlend = 0x0BE2,
  kUnsignedByte = 0x1401,
  kFloat = 0x1406,
  kColor = 0x1800,
  kRed = 0x1903,
  kRenderer = 0x1F01,
  kMin = 0x8007,
  kMax = 0x8008,
  kMajorVersion = 0x821B,
  kMinorVersion = 0x821C,
  kR32f = 0x822E,
  kArrayBuffer = 0x8892,
  kElementArrayBuffer = 0x8893,
  kStaticDraw = 0x88E4,
  kFragmentShader = 0x8B30,
  kVertexShader = 0x8B31,
  kLinkStatus = 0x8B82,
  kFramebufferComplete = 0x8CD5,
  kColorAttachment0 = 0x8CE0,
  kFramebuffer = 0x8D40,
  kRenderbuffer = 0x8D41,
  kGeometryShader = 0x8DD9,
};

}  // namespace docdepth::gl
