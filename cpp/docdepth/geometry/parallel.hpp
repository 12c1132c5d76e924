// A parallel loop.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace docdepth {

/// Number of threads: `threads`, or the number of cores if that is 0.
inline int thread_count(int threads) {
  return threads > 0 ? threads : std::max(1u, std::thread::hardware_concurrency());
}

/// Call body(begin, end) on blocks that cover [0, count). Blocks do not depend on the number of
/// threads, so a body that only writes into its own block gives the same result for any number.
/// Plain threads instead of OpenMP, which does not survive a fork (multiprocessing, Dask).
/// @throws the first exception of a body
template <class Body>
void parallel_for(std::size_t count, std::size_t block, int threads, const Body& body) {
  const std::size_t blocks = (count + block - 1) / block;
  const auto workers = std::min<std::size_t>(thread_count(threads), blocks);
  std::atomic<std::size_t> next{0};
  std::exception_ptr failure;
  std::mutex failure_mutex;
  const auto work = [&] {
    try {
      for (std::size_t b; (b = next.fetch_add(1)) < blocks;)
        body(b * block, std::min(count, (b + 1) * block));
    } catch (...) {
      const std::lock_guard<std::mutex> lock(failure_mutex);
      if (!failure) failure = std::current_exception();
      next = blocks;
    }
  };
  std::vector<std::thread> pool;
  pool.reserve(workers);
  try {
    for (std::size_t i = 1; i < workers; ++i) pool.emplace_back(work);
  } catch (const std::system_error&) {
    // The system gives no more threads; those that run do all the work.
  }
  work();
  for (auto& thread : pool) thread.join();
  if (failure) std::rethrow_exception(failure);
}

}  // namespace docdepth
