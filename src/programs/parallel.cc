#include "programs/parallel.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <iostream>
#include <map>
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
    Clock::time_point start;
  };

  JobName name;
  Job job;
  std::mutex mutex;  // guards what follows
  std::condition_variable changed;
  std::vector<char> started;  // of each job
  // By index. A job that comes back after an interrupt stays here and is not done: it may have been cut short.
  std::map<int, Entry> at_work;
  int next = 0;
  int64_t done = 0;
  int threads = 0;  // that run
  std::exception_ptr thrown;

  // The jobs at work, the longest first: "ncp for 12 s, lcp".
  std::string DescribeRunningJobs() const {
    std::vector<const Entry*> longest_first;
    for (const auto& [index, entry] : at_work) longest_first.push_back(&entry);
    std::ranges::stable_sort(longest_first, [](const Entry* a, const Entry* b) { return a->start < b->start; });
    std::string text;
    for (size_t i = 0; i < longest_first.size() && i < kMostNames; ++i) {
      const Entry& entry = *longest_first[i];
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
  const int count = static_cast<int>(board->started.size());
  while (board->next < count && !InterruptGuard::Interrupted() && !board->thrown) {
    const int i = board->next++;
    board->started[i] = true;
    Board::Entry& entry = board->at_work.emplace(i, Board::Entry{board->name(i), "", Clock::now()}).first->second;
    lock.unlock();
    std::exception_ptr thrown;
    try {
      board->job(i, [&](const std::string& note) {
        const std::lock_guard say(board->mutex);
        entry.note = note;
      });
    } catch (...) {
      thrown = std::current_exception();
    }
    lock.lock();
    if (!InterruptGuard::Interrupted()) {
      ++board->done;
      board->at_work.erase(i);
    }
    if (thrown && !board->thrown) board->thrown = thrown;
    board->changed.notify_all();
  }
  --board->threads;
  board->changed.notify_all();
}

}  // namespace

bool IsStopRequested() { return InterruptGuard::Interrupted(); }

JobsEnd RunJobsOrAbandon(int count, const JobName& name, int threads, Progress* progress, const Job& job) {
  const auto board = std::make_shared<Board>();
  board->name = name;
  board->job = job;
  board->started.resize(count);
  std::vector<std::thread> workers;
  std::unique_lock lock(board->mutex);
  while (board->threads < std::min(threads, count)) {
    try {
      workers.emplace_back([board] { Work(board.get()); });
      ++board->threads;
    } catch (const std::system_error&) {
      if (workers.empty()) throw;
      break;  // fewer will do
    }
  }

  Clock::time_point give_up = Clock::time_point::max();
  int64_t reported = 0;
  while (board->threads > 0 && Clock::now() < give_up) {
    board->changed.wait_for(lock, kLook);
    if (InterruptGuard::Interrupted()) give_up = std::min(give_up, Clock::now() + kGrace);
    progress->Advance(board->done - std::exchange(reported, board->done), board->DescribeRunningJobs());
  }
  const int64_t done = board->done;
  JobsEnd end{board->started, done == count, board->threads > 0, board->thrown};
  const std::string at_work = board->DescribeRunningJobs();
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
    std::cerr << "interrupted" << (at_work.empty() ? "" : " at " + at_work) << "; " << done << " of " << count
              << " were done" << std::endl;
  }
  if (end.abandoned) EndWithoutWaiting();
  return end;
}

JobsEnd RunJobsOrAbandon(const std::vector<std::string>& names, int threads, Progress* progress, const Job& job) {
  progress->UnitsDiffer();
  return RunJobsOrAbandon(
      static_cast<int>(names.size()), [names](int i) { return names[i]; }, threads, progress, job);
}

bool RunJobs(const std::vector<std::string>& names, int threads, Progress* progress, const Job& job) {
  const JobsEnd end = RunJobsOrAbandon(names, threads, progress, job);
  // The program ends before an exception destroys the objects that the abandoned jobs use.
  if (end.abandoned) EndProgram(kAnswerFailed);
  if (end.thrown) std::rethrow_exception(end.thrown);
  return end.complete;
}

}  // namespace saltus
