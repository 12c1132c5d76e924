#include "docdepth/geometry/types.hpp"
