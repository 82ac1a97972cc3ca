// Sharing the work of one call between threads, without a C++ run-time library.
//
// Every thread makes the same call (WorkerPool.run) and walks through the same steps. The items of a step are taken
// from one counter, so that no thread waits for another's share, and a step ends when all its items are *done*: a
// thread that arrives late finds them done and walks on. Nothing here depends on how many threads came.
#pragma once
#include <stdint.h>

#if defined(_WIN32)
extern "C" __declspec(dllimport) int SwitchToThread(void);
#else
#include <time.h>
#endif

namespace jg {

constexpr int CACHE_LINE = 64;
constexpr int TEAM_STEPS = 16;  // steps of one call; native/binding.py allocates as many

// The counters of one step, alone on their cache lines: threads write them at the same time.
struct Step {
  alignas(CACHE_LINE) int32_t next;
  alignas(CACHE_LINE) int32_t done;
};

// Set to zero before each call (by the thread that makes it, before it starts the others).
struct Team {
  Step steps[TEAM_STEPS];
};

// Waiting for the last items of another thread: at first without leaving the processor, because they take microseconds.
// Then asleep, because other programs may have the other thread's processor: it comes back within some milliseconds,
// and who sleeps meanwhile is let in at once afterwards, while who only yields has used up its turn.
inline void wait_a_moment(int turn) {
  if (turn < 4096) {
#if defined(__x86_64__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ volatile("yield");
#endif
    return;
  }
#if defined(_WIN32)
  SwitchToThread();  // the shortest sleep there may last 15 ms
#else
  const struct timespec nap = {0, 50000};  // 50 us: the system's timers are no finer
  nanosleep(&nap, nullptr);
#endif
}

// Calls work(i) once for every i in [0, items), together with the other threads of the team; returns when all are done.
// What any item wrote is visible to every thread afterwards. Steps are numbered in the order in which they are walked.
template <class Work>
inline void share(Team& team, int step, int32_t items, Work work) {
  Step& s = team.steps[step];
  for (int32_t i; (i = __atomic_fetch_add(&s.next, 1, __ATOMIC_RELAXED)) < items;) {
    work(i);
    __atomic_fetch_add(&s.done, 1, __ATOMIC_RELEASE);
  }
  for (int turn = 0; __atomic_load_n(&s.done, __ATOMIC_ACQUIRE) < items; turn++) wait_a_moment(turn);
}

// The part of [0, n) that belongs to item i of `items`.
struct Range {
  int64_t begin, end;
};
inline Range part_of(int64_t n, int32_t i, int32_t items) { return {n * i / items, n * (i + 1) / items}; }

}  // namespace jg
