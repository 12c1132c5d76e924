# Header libraries: the installed ones, else the pinned archives. Nothing is downloaded when they
# are installed, so -DFETCHCONTENT_FULLY_DISCONNECTED=ON builds offline.
include(FetchContent)

find_package(Eigen3 3.4 QUIET NO_MODULE)  # 3.3 does not compile as C++20
if(NOT TARGET Eigen3::Eigen)
  find_package(Eigen3 5 QUIET NO_MODULE)  # follows 3.4, and says that it is not compatible
endif()
if(NOT TARGET Eigen3::Eigen)
  FetchContent_Declare(eigen
    URL https://gitlab.com/libeigen/eigen/-/archive/3.4.0/eigen-3.4.0.tar.gz
    URL_HASH SHA256=8586084f71f9bde545ee7fa6d00288b264a2b7ac3607b974e54d13e7162c1c72
    SOURCE_SUBDIR no-build)  # headers only: its own CMakeLists.txt builds tests and Fortran
  FetchContent_MakeAvailable(eigen)
  add_library(docdepth_eigen INTERFACE)
  add_library(Eigen3::Eigen ALIAS docdepth_eigen)
  target_include_directories(docdepth_eigen SYSTEM INTERFACE ${eigen_SOURCE_DIR})
endif()

find_package(nanoflann QUIET)
if(NOT TARGET nanoflann::nanoflann)
  FetchContent_Declare(nanoflann
    URL https://github.com/jlblancoc/nanoflann/archive/v1.4.3.tar.gz
    URL_HASH SHA256=cbcecf22bec528a8673a113ee9b0e134f91f1f96be57e913fa1f74e98e4449fa
    SOURCE_SUBDIR no-build)
  FetchContent_MakeAvailable(nanoflann)
  add_library(docdepth_nanoflann INTERFACE)
  add_library(nanoflann::nanoflann ALIAS docdepth_nanoflann)
  target_include_directories(docdepth_nanoflann SYSTEM INTERFACE ${nanoflann_SOURCE_DIR}/include)
endif()
