#include "programs/parallel.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <iostream>
#include <mutex>
#include <system_error>
#include <thread>

#include "base/interrupt.h"
#include "programs/program.h"

namespace saltus {
namespace {

using Clock = std::chrono::steady_clock;

// For jobs at work to come back after an interrupt: more than what is left to their checks
// (InterruptGuard::GraceIsOver).
constexpr std::chrono::milliseconds kGrace(700);
constexpr std::chrono::milliseconds kLook(50);  // how often interrupts are looked for, and the progress told
constexpr int kSlow = 5;                        // s: of a job that takes longer, how long is said
constexpr size_t kMostNames = 4;

std::atomic<bool> interrupt_said{false};  // once is enough, whatever else is left out

// Data that the threads share with the one that waits for them; they keep it when that one has left.
struct Board {
  struct Entry {
    std::string name, note;
    // A job that comes back after an interrupt is not done: it may have been cut short.
    bool started = false, done = false;
    Clock::time_point start;
  };

  Job job;
  std::mutex mutex;  // guards what follows
  std::condition_variable changed;
  std::vector<Entry> entries;
  size_t next = 0;
  int threads = 0;  // that run
  std::exception_ptr thrown;

  // The jobs at work, the longest first: "ncp for 12 s, lcp".
  std::string AtWork() const {
    std::vector<const Entry*> at_work;
    for (const Entry& entry : entries) {
      if (entry.started && !entry.done) at_work.push_back(&entry);
    }
    std::ranges::stable_sort(at_work, [](const Entry* a, const Entry* b) { return a->start < b->start; });
    std::string text;
    for (size_t i = 0; i < at_work.size() && i < kMostNames; ++i) {
      const Entry& entry = *at_work[i];
      text += (i == 0 ? "" : ", ") + entry.name;
      const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(Clock::now() - entry.start).count();
      if (seconds >= kSlow) text += " for " + std::to_string(seconds) + " s";
      if (!entry.note.empty()) text += " (" + entry.note + ")";
    }
    if (at_work.size() > kMostNames) text += " and " + std::to_string(at_work.size() - kMostNames) + " more";
    return text;
  }
};

void Work(Board* board) {
  std::unique_lock lock(board->mutex);
  while (board->next < board->entries.size() && !InterruptGuard::Interrupted() && !board->thrown) {
    const size_t i = board->next++;
    Board::Entry& entry = board->entries[i];
    entry.started = true;
    entry.start = Clock::now();
    lock.unlock();
    std::exception_ptr thrown;
    try {
      board->job(static_cast<int>(i), [&](const std::string& note) {
        const std::lock_guard say(board->mutex);
        entry.note = note;
      });
    } catch (...) {
      thrown = std::current_exception();
    }
    lock.lock();
    entry.done = !InterruptGuard::Interrupted();
    if (thrown && !board->thrown) board->thrown = thrown;
    board->changed.notify_all();
  }
  --board->threads;
  board->changed.notify_all();
}

}  // namespace

bool AskedToStop() { return InterruptGuard::Interrupted(); }

JobsEnd RunJobsOrAbandon(const std::vector<std::string>& names, int threads, Progress* progress, const Job& job) {
  progress->UnitsDiffer();  // the gradient of one model and the audit of another, or solvers of seconds and of minutes
  const auto board = std::make_shared<Board>();
  board->job = job;
  for (const std::string& name : names) board->entries.push_back({name, "", false, false, {}});
  std::vector<std::thread> workers;
  std::unique_lock lock(board->mutex);
  while (board->threads < std::min<int>(threads, static_cast<int>(names.size()))) {
    try {
      workers.emplace_back([board] { Work(board.get()); });
      ++board->threads;
    } catch (const std::system_error&) {
      if (workers.empty()) throw;
      break;  // fewer will do
    }
  }

  const auto num_done = [&] { return std::ranges::count(board->entries, true, &Board::Entry::done); };
  Clock::time_point give_up = Clock::time_point::max();
  int64_t reported = 0;
  while (board->threads > 0 && Clock::now() < give_up) {
    board->changed.wait_for(lock, kLook);
    if (InterruptGuard::Interrupted()) give_up = std::min(give_up, Clock::now() + kGrace);
    const int64_t done = num_done();
    progress->Advance(done - std::exchange(reported, done), board->AtWork());
  }
  JobsEnd end;
  for (const Board::Entry& entry : board->entries) end.started.push_back(entry.started);
  const int64_t done = num_done();
  end.complete = done == static_cast<int64_t>(names.size());
  const std::string at_work = board->AtWork();
  end.abandoned = board->threads > 0;
  end.thrown = board->thrown;
  lock.unlock();
  for (std::thread& worker : workers) {
    if (end.abandoned) {
      worker.detach();
    } else {
      worker.join();
    }
  }
  if (InterruptGuard::Interrupted() && !end.complete && !interrupt_said.exchange(true)) {
    progress->Finish();
    std::cerr << "interrupted" << (at_work.empty() ? "" : " at " + at_work) << "; " << done << " of " << names.size()
              << " were done" << std::endl;
  }
  if (end.abandoned) EndWithoutWaiting();
  return end;
}

bool RunJobs(const std::vector<std::string>& names, int threads, Progress* progress, const Job& job) {
  const JobsEnd end = RunJobsOrAbandon(names, threads, progress, job);
  // The program ends before an exception destroys the objects that the abandoned jobs use.
  if (end.abandoned) EndProgram(kAnswerFailed);
  if (end.thrown) std::rethrow_exception(end.thrown);
  return end.complete;
}

}  // namespace saltus
