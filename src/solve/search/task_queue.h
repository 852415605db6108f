// Tasks that several threads work off, with the outcome of one.
//
// A task is drawn, solved by any thread, and looked at. Drawing and looking are for the calling thread, and their order
// depends on the tasks alone: the oldest is looked at first, and after each look so many are drawn that kMostUnderWay
// are under way.
#pragma once

#include <condition_variable>
#include <exception>
#include <functional>
#include <list>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

namespace saltus {

inline constexpr std::size_t kMostUnderWay = 8;

template <typename Task, typename Finding>
struct TaskQueue {
  std::function<std::optional<Task>()> draw;       // the next; nothing if there is none until another is looked at
  std::function<Finding(const Task&)> solve;       // called by several threads at the same time
  std::function<void(const Task&, Finding)> look;  // at what the task has found

  // Works until no task runs and none is drawn. An exception of `solve` is thrown here, where its outcome would be
  // consumed. Precondition: threads > 0; with one thread the caller does all work.
  void RunAll(int threads);

 private:
  enum class State { kWaiting, kBegun, kSolved };
  struct Entry {
    Task task;
    State state = State::kWaiting;
    Finding finding = {};
    std::exception_ptr thrown = nullptr;
  };
  struct Shared {
    std::mutex mutex;
    std::condition_variable changed;
    std::list<Entry> entries;  // in the order in which they are looked at
    bool closed = false;
  };
  // Helper threads, which end after their present task.
  struct Helpers {
    Shared* shared;
    std::vector<std::thread> threads = {};
    ~Helpers() {
      {
        const std::lock_guard lock(shared->mutex);
        shared->closed = true;
      }
      shared->changed.notify_all();
      for (std::thread& helper : threads) helper.join();
    }
  };

  void Fill(Shared* shared) const;
  void Help(Shared* shared) const;
};

template <typename Task, typename Finding>
void TaskQueue<Task, Finding>::Fill(Shared* shared) const {
  while (shared->entries.size() < kMostUnderWay) {  // which this thread alone changes
    std::optional<Task> task = draw();
    if (!task) return;
    const std::lock_guard lock(shared->mutex);
    shared->entries.push_back({std::move(*task)});
    shared->changed.notify_all();
  }
}

// Solves what waits, the next one to be looked at first, until the line is closed.
template <typename Task, typename Finding>
void TaskQueue<Task, Finding>::Help(Shared* shared) const {
  std::unique_lock lock(shared->mutex);
  while (!shared->closed) {
    auto next = shared->entries.begin();
    while (next != shared->entries.end() && next->state != State::kWaiting) ++next;
    if (next == shared->entries.end()) {
      shared->changed.wait(lock);
      continue;
    }
    next->state = State::kBegun;
    lock.unlock();
    try {
      next->finding = solve(next->task);  // nobody else touches an entry that is begun
    } catch (...) {
      next->thrown = std::current_exception();
    }
    lock.lock();
    next->state = State::kSolved;
    shared->changed.notify_all();
  }
}

template <typename Task, typename Finding>
void TaskQueue<Task, Finding>::RunAll(int threads) {
  Shared shared;
  Helpers helpers{&shared};
  for (int i = 0; threads > 1 && i < threads; ++i) helpers.threads.emplace_back([&] { Help(&shared); });
  for (Fill(&shared); !shared.entries.empty(); Fill(&shared)) {
    std::list<Entry> first;
    if (helpers.threads.empty()) {
      Entry& entry = shared.entries.front();
      entry.finding = solve(entry.task);
      first.splice(first.begin(), shared.entries, shared.entries.begin());
    } else {
      std::unique_lock lock(shared.mutex);
      shared.changed.wait(lock, [&] { return shared.entries.front().state == State::kSolved; });
      first.splice(first.begin(), shared.entries, shared.entries.begin());
    }
    if (first.front().thrown) std::rethrow_exception(first.front().thrown);
    look(first.front().task, std::move(first.front().finding));
  }
}

}  // namespace saltus
