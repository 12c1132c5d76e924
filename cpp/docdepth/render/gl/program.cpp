#include "docdepth/render/gl/program.hpp"

#include <string>

#include "docdepth/render/gl/shaders.hpp"

namespace docdepth::gl {
namespace {

unsigned compile(const GlContext::Current& gl, const Shader& shader) {
  const unsigned name = gl->CreateShader(shader.kind);
  const char* sources[] = {kExact, shader.source};
  gl->ShaderSource(name, 2, sources, nullptr);
  gl->CompileShader(name);
  int well = 0;
  gl->GetShaderiv(name, kCompileStatus, &well);
  if (!well) {
    char log[1024] = "";
    gl->GetShaderInfoLog(name, sizeof log, nullptr, log);
    throw GlError(std::string("the driver does not compile a shader: ") + log);
  }
  return name;
}

}  // namespace

unsigned link(const GlContext::Current& gl, const std::vector<Shader>& shaders) {
  const unsigned program = gl->CreateProgram();
  for (const auto& shader : shaders) {
    const unsigned name = compile(gl, shader);
    gl->AttachShader(program, name);
    gl->DeleteShader(name);
  }
  gl->LinkProgram(program);
  int well = 0;
  gl->GetProgramiv(program, kLinkStatus, &well);
  if (!well) {
    char log[1024] = "";
    gl->GetProgramInfoLog(program, sizeof log, nullptr, log);
    throw GlError(std::string("the driver does not link a program: ") + log);
  }
  return program;
}

}  // namespace docdepth::gl
