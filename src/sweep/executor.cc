#include "sweep/executor.h"

#include <glog/logging.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <map>
#include <stdexcept>

#include "base/interrupt.h"
#include "sweep/output.h"
#include "sweep/point.h"

namespace saltus {
namespace {

// A solver that looks at the clock itself returns what it has reached; only what does not is stopped from outside.
constexpr double kGraceSeconds = 0.5;

// Computes what it is asked for until its socket is closed. Never returns: this process has no other business.
[[noreturn]] void Serve(int socket, pid_t parent, const WorkerPool::Work& work) {
  // The parent decides what an interrupt means, and takes its workers with it when it dies.
  std::signal(SIGINT, SIG_IGN);
  std::signal(SIGTERM, SIG_IGN);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(0);
  int64_t task = 0;
  while (recv(socket, &task, sizeof(task), 0) == sizeof(task)) {
    const std::string answer = work(task);
    CHECK_LE(answer.size(), WorkerPool::kLongestAnswer);
    if (send(socket, answer.data(), answer.size(), MSG_NOSIGNAL) < 0) break;
  }
  _exit(0);
}

std::string HowItEnded(int status) {
  if (WIFSIGNALED(status)) {
    const int signal = WTERMSIG(status);
    return "killed by signal " + std::to_string(signal) + " (" + strsignal(signal) + ")";
  }
  return "exit code " + std::to_string(WEXITSTATUS(status));
}

// Whether MPI has started this process, by its environment: a sweep that runs alone does not start MPI.
bool StartedByMpi() {
  for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK"}) {
    if (std::getenv(name) != nullptr) return true;
  }
  return false;
}

using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds kLookForInterrupts(100);
constexpr std::chrono::seconds kSlow(5);

// "point 3 (stiffness=100, contact=ncp, solver=gd) for 12 s", of the one that was started first if that is long ago.
std::string SlowestOf(const SweepStudy& study, const std::map<int64_t, Clock::time_point>& at_work) {
  const auto first =
      std::ranges::min_element(at_work, [](const auto& a, const auto& b) { return a.second < b.second; });
  if (first == at_work.end()) return "";
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(Clock::now() - first->second);
  if (seconds < kSlow) return "";
  return PlaceOf(study, first->first) + " for " + std::to_string(seconds.count()) + " s";
}

}  // namespace

LocalExecutor::LocalExecutor(const SweepStudy& study, int workers, double seconds)
    : study_(study),
      seconds_(seconds),
      pool_(workers, seconds > 0 ? seconds + kGraceSeconds : 0,
            [&study, seconds](int64_t point) { return Encode(ComputePoint(study, point, seconds)); }) {}

std::vector<FinishedPoint> LocalExecutor::Wait(std::chrono::microseconds timeout) {
  std::vector<FinishedPoint> points;
  for (const WorkerPool::Result& result : pool_.Wait(timeout)) points.push_back({result.task, ToPoint(result)});
  return points;
}

PointResult LocalExecutor::ToPoint(const WorkerPool::Result& result) const {
  switch (result.end) {
    case WorkerPool::End::kAnswered:
      return DecodePointResult(result.text);
    case WorkerPool::End::kTooLate:
      return FailedPoint(study_, result.task, TimeLimitReason(seconds_));
    case WorkerPool::End::kDied:
      break;
  }
  return FailedPoint(study_, result.task, "its process died: " + result.text);
}

WorkerPool::WorkerPool(int workers, double seconds, Work work) : seconds_(seconds), work_(std::move(work)) {
  CHECK_GT(workers, 0);
  workers_.resize(static_cast<size_t>(workers));
  for (Worker& worker : workers_) Launch(&worker);
}

WorkerPool::~WorkerPool() {
  for (Worker& worker : workers_) {
    if (worker.process < 0) continue;  // it could not be started
    kill(worker.process, SIGKILL);
    Reap(&worker);
  }
}

void WorkerPool::Launch(Worker* worker) {
  int sockets[2] = {-1, -1};
  // Keeps the boundaries of messages, and tells when the other end is gone.
  const bool connected = socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, sockets) == 0;
  const pid_t parent = getpid();
  if (connected) worker->process = fork();
  if (worker->process < 0) {
    const std::string why = std::strerror(errno);
    for (const int socket : sockets) close(socket);
    throw std::runtime_error("cannot start a process that computes: " + why);
  }
  if (worker->process == 0) {
    // The parent's ends would keep the other workers' sockets open.
    for (const Worker& other : workers_) {
      if (other.socket >= 0) close(other.socket);
    }
    close(sockets[0]);
    Serve(sockets[1], parent, work_);
  }
  close(sockets[1]);
  worker->socket = sockets[0];
}

std::string WorkerPool::Reap(Worker* worker) {
  int status = 0;
  while (waitpid(worker->process, &status, 0) < 0 && errno == EINTR) {
  }
  close(worker->socket);
  worker->socket = worker->process = -1;
  return HowItEnded(status);
}

void WorkerPool::Start(int64_t task) {
  const auto worker = std::ranges::find(workers_, false, &Worker::busy);
  CHECK(worker != workers_.end());
  worker->busy = true;
  worker->task = task;
  worker->deadline = Clock::time_point::max();
  if (seconds_ > 0) {
    worker->deadline = Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                          std::chrono::duration<double>(std::min(seconds_, 1e9)));
  }
  ++busy_;
  while (send(worker->socket, &task, sizeof(task), MSG_NOSIGNAL) != sizeof(task)) {
    if (errno == EINTR) continue;
    // The worker was killed while it was idle.
    Reap(&*worker);
    Launch(&*worker);
  }
}

WorkerPool::Clock::duration WorkerPool::UntilDeadline() const {
  Clock::time_point first = Clock::time_point::max();
  for (const Worker& worker : workers_) {
    if (worker.busy) first = std::min(first, worker.deadline);
  }
  if (first == Clock::time_point::max()) return Clock::duration::max();
  return std::max(first - Clock::now(), Clock::duration::zero());
}

std::vector<WorkerPool::Result> WorkerPool::Wait(std::chrono::microseconds timeout) {
  std::vector<pollfd> sockets;
  for (const Worker& worker : workers_) {
    sockets.push_back({worker.busy ? worker.socket : -1, POLLIN, 0});  // -1: not looked at
  }
  const auto wait = std::chrono::ceil<std::chrono::microseconds>(std::min<Clock::duration>(timeout, UntilDeadline()));
  const timespec time = {static_cast<time_t>(wait.count() / 1'000'000),
                         static_cast<long>(wait.count() % 1'000'000 * 1000)};
  const int ready = ppoll(sockets.data(), sockets.size(), &time, nullptr);
  if (ready < 0 && errno != EINTR) {
    throw std::runtime_error(std::string("cannot wait for the processes that compute: ") + std::strerror(errno));
  }
  std::vector<Result> results;
  for (size_t i = 0; i < workers_.size(); ++i) {
    Worker& worker = workers_[i];
    if (!worker.busy) continue;
    const bool answered = ready > 0 && sockets[i].revents != 0;
    if (answered || Clock::now() >= worker.deadline) results.push_back(Finish(&worker));
  }
  return results;
}

// The answer that is there, or the end of a worker that died or is too late.
WorkerPool::Result WorkerPool::Finish(Worker* worker) {
  Result result;
  result.task = worker->task;
  std::string answer(kLongestAnswer, '\0');
  ssize_t size = 0;
  do {
    size = recv(worker->socket, answer.data(), answer.size(), MSG_DONTWAIT);
  } while (size < 0 && errno == EINTR);
  if (size > 0) {
    result.text = answer.substr(0, static_cast<size_t>(size));
  } else {
    const bool late = size < 0;  // it lives, without an answer
    if (late) kill(worker->process, SIGKILL);
    const std::string how = Reap(worker);
    result.end = late ? End::kTooLate : End::kDied;
    if (!late) result.text = how;
    Launch(worker);
  }
  worker->busy = false;
  --busy_;
  return result;
}

std::unique_ptr<SweepCluster> JoinCluster() {
  if (!StartedByMpi()) return nullptr;
#if SALTUS_WITH_MPI
  return JoinMpi();
#else
  throw InputError("started as an MPI job, but built without MPI; expected a build with SALTUS_WITH_MPI=ON");
#endif
}

std::vector<int64_t> PendingPoints(const SweepStudy& study, Shard shard, const SweepStore& store,
                                   const std::function<void()>& tick) {
  constexpr int64_t kPointsATick = 10'000;
  std::vector<int64_t> points;
  for (int64_t point = shard.index - 1; point < study.size(); point += shard.count) {
    if (!store.Has(point)) points.push_back(point);
    if (InterruptGuard::Interrupted()) break;
    if (tick && point / shard.count % kPointsATick == 0) tick();
  }
  return points;
}

Status RunPoints(const SweepStudy& study, const std::vector<int64_t>& points, SweepExecutor* executor,
                 SweepStore* store, Progress* progress) {
  std::map<int64_t, Clock::time_point> at_work;
  for (size_t next = 0; next < points.size() || executor->HasBusy();) {
    // Points that workers have finished by then are stored after an interrupt, too.
    const bool interrupted = InterruptGuard::Interrupted();
    for (; !interrupted && next < points.size() && executor->HasRoom(); ++next) {
      executor->Start(points[next]);
      at_work[points[next]] = Clock::now();
    }
    for (const FinishedPoint& finished :
         executor->Wait(interrupted ? std::chrono::milliseconds(0) : kLookForInterrupts)) {
      if (Status status = store->Add(finished.point, finished.result); !status.ok()) return status;
      progress->Advance();
      at_work.erase(finished.point);
    }
    if (interrupted) break;
    progress->Advance(0, SlowestOf(study, at_work));
  }
  return Status();
}

}  // namespace saltus
