#include "programs/sweep/mpi_cluster.h"

#include <glog/logging.h>
#include <mpi.h>

#include <algorithm>
#include <array>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <thread>

namespace saltus {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::microseconds;

// Everyone says something at least every kHeartbeat: the one thread of a rank only passes messages on, its workers
// compute. Rank 0 may be silent for longer, while it looks for the points that are missing.
constexpr std::chrono::milliseconds kHeartbeat(500);
constexpr std::chrono::seconds kSilence(5);
constexpr std::chrono::minutes kSilenceOfRank0(5);

enum Tag {
  kHello,     // a rank joins: how many points at a time, and of which study
  kDecline,   // or does not: why
  kPoint,     // rank 0 wants a point
  kResult,    // and gets it
  kAlive,     // nothing new
  kStop,      // rank 0 wants no more
  kBye,       // a rank has stopped
  kFinalize,  // all have: leave together
  kLeave,     // some are gone: leave without waiting for them, which MPI_Finalize would do for ever
};

// MPI's own waiting keeps a core busy, so messages are looked for, less and less often while there are none.
class Patience {
 public:
  void Reset() { delay_ = kLeast; }
  microseconds Next() {
    const microseconds delay = delay_;
    delay_ = std::min(2 * delay_, kMost);
    return delay;
  }

 private:
  static constexpr microseconds kLeast{20};
  static constexpr microseconds kMost{2000};
  microseconds delay_ = kLeast;
};

struct Message {
  int source = 0;
  Tag tag = kAlive;
  std::string bytes;
};

void Send(int rank, Tag tag, const std::string& bytes) {
  MPI_Send(bytes.data(), static_cast<int>(bytes.size()), MPI_BYTE, rank, tag, MPI_COMM_WORLD);
}

// A message that has arrived, if any.
std::optional<Message> Receive() {
  int arrived = 0;
  MPI_Status status;
  MPI_Iprobe(MPI_ANY_SOURCE, MPI_ANY_TAG, MPI_COMM_WORLD, &arrived, &status);
  if (arrived == 0) return std::nullopt;
  int size = 0;
  MPI_Get_count(&status, MPI_BYTE, &size);
  Message message{status.MPI_SOURCE, static_cast<Tag>(status.MPI_TAG), std::string(static_cast<size_t>(size), '\0')};
  MPI_Recv(message.bytes.data(), size, MPI_BYTE, status.MPI_SOURCE, status.MPI_TAG, MPI_COMM_WORLD, MPI_STATUS_IGNORE);
  return message;
}

std::string PackPoint(int64_t point) { return {reinterpret_cast<const char*>(&point), sizeof(point)}; }

int64_t UnpackPoint(const std::string& bytes) {
  int64_t point = 0;
  CHECK_GE(bytes.size(), sizeof(point));
  std::copy_n(bytes.data(), sizeof(point), reinterpret_cast<char*>(&point));
  return point;
}

// What a rank says of itself: how many points at a time, and of which study.
std::string Hello(const SweepStudy& study, int workers) {
  return PackPoint(workers) + PackPoint(static_cast<int64_t>(std::hash<std::string>()(study.Description())));
}

class ClusterExecutor : public SweepExecutor {
 public:
  ClusterExecutor(const SweepStudy& study, MpiCluster* cluster, LocalExecutor* local)
      : cluster_(*cluster),
        expected_hello_(Hello(study, 0).substr(sizeof(int64_t))),
        local_(*local),
        ranks_(static_cast<size_t>(cluster->size())) {}
  ~ClusterExecutor() override { cluster_.Dismiss(Lost()); }

  bool HasRoom() const override { return orphans_.empty() && HasFreeWorker(); }

  bool HasBusy() const override { return local_.HasBusy() || !orphans_.empty() || !away_.empty(); }

  void Start(int64_t point) override {
    if (local_.HasRoom()) {
      local_.Start(point);
      return;
    }
    const int rank = FreeRank();
    CHECK_GT(rank, 0);
    away_[point] = rank;
    --ranks_[rank].room;
    Send(rank, kPoint, PackPoint(point));
  }

  std::vector<FinishedPoint> Wait(microseconds timeout) override {
    const Clock::time_point end = Clock::now() + timeout;
    std::vector<FinishedPoint> points;
    do {
      const bool hello = ReceiveAll(&points);
      GiveUpSilentRanks();
      RestartOrphans();
      SayAlive();
      // A new rank has room, whom the caller should know of.
      if (hello) return points;
      for (FinishedPoint& point : local_.Wait(points.empty() ? patience_.Next() : microseconds(0))) {
        points.push_back(std::move(point));
      }
    } while (points.empty() && Clock::now() < end);
    if (!points.empty()) patience_.Reset();
    return points;
  }

 private:
  struct Rank {
    int room = 0;  // how many more points it takes
    bool lost = false;
    Clock::time_point heard;
  };

  std::set<int> Lost() const {
    std::set<int> lost;
    for (size_t rank = 1; rank < ranks_.size(); ++rank) {
      if (ranks_[rank].lost) lost.insert(static_cast<int>(rank));
    }
    return lost;
  }

  int FreeRank() const {
    for (size_t rank = 1; rank < ranks_.size(); ++rank) {
      if (!ranks_[rank].lost && ranks_[rank].room > 0) return static_cast<int>(rank);
    }
    return -1;
  }

  bool HasFreeWorker() const { return local_.HasRoom() || FreeRank() > 0; }

  // Whether a rank has joined.
  bool ReceiveAll(std::vector<FinishedPoint>* points) {
    bool hello = false;
    while (const std::optional<Message> message = Receive()) {
      Rank& rank = ranks_[message->source];
      rank.heard = Clock::now();
      // Merely slow: what it was computing has been given to others, but it can go on.
      rank.lost = false;
      if (message->tag == kHello) {
        Welcome(*message);
        hello = true;
      } else if (message->tag == kDecline) {
        LeaveOut(message->source, message->bytes);
      } else if (message->tag == kResult) {
        TakeResult(*message, points);
      }
    }
    return hello;
  }

  void Welcome(const Message& message) {
    if (message.bytes.substr(sizeof(int64_t)) == expected_hello_) {
      ranks_[message.source].room = static_cast<int>(UnpackPoint(message.bytes));
    } else {
      LeaveOut(message.source, "it has another study (another scene file?)");
    }
  }

  void LeaveOut(int rank, const std::string& why) {
    // Nothing is asked of it or expected from it.
    ranks_[rank] = Rank();
    LOG(ERROR) << "rank " << rank << " is left out: " << why;
  }

  void TakeResult(const Message& message, std::vector<FinishedPoint>* points) {
    ++ranks_[message.source].room;
    const int64_t point = UnpackPoint(message.bytes);
    const auto found = away_.find(point);
    // A rank that was given up comes too late if the point has gone to another.
    if (found == away_.end() || found->second != message.source) return;
    away_.erase(found);
    points->push_back({point, DecodePointResult(message.bytes.substr(sizeof(point)))});
  }

  void GiveUpSilentRanks() {
    const Clock::time_point now = Clock::now();
    for (size_t rank = 1; rank < ranks_.size(); ++rank) {
      const bool joined = ranks_[rank].heard != Clock::time_point();
      if (!joined || ranks_[rank].lost || now - ranks_[rank].heard < kSilence) continue;
      ranks_[rank].lost = true;
      LOG(WARNING) << "rank " << rank << " is silent; its points go to others";
      for (auto it = away_.begin(); it != away_.end();) {
        if (it->second != static_cast<int>(rank)) {
          ++it;
          continue;
        }
        orphans_.push_back(it->first);
        it = away_.erase(it);
      }
    }
  }

  void SayAlive() {
    if (Clock::now() - said_alive_ < kHeartbeat) return;
    said_alive_ = Clock::now();
    for (size_t rank = 1; rank < ranks_.size(); ++rank) {
      if (!ranks_[rank].lost) Send(static_cast<int>(rank), kAlive, "");
    }
  }

  void RestartOrphans() {
    while (!orphans_.empty() && HasFreeWorker()) {
      const int64_t point = orphans_.front();
      orphans_.pop_front();
      Start(point);
    }
  }

  MpiCluster& cluster_;
  std::string expected_hello_;
  LocalExecutor& local_;
  std::vector<Rank> ranks_;
  std::map<int64_t, int> away_;  // points that are being computed by other ranks
  std::deque<int64_t> orphans_;  // points of ranks that were given up
  Clock::time_point said_alive_;
  Patience patience_;
};

}  // namespace

MpiCluster::MpiCluster() {
  MPI_Init(nullptr, nullptr);
  // A message to a rank that is gone is lost, no reason to end.
  MPI_Comm_set_errhandler(MPI_COMM_WORLD, MPI_ERRORS_RETURN);
  MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
  MPI_Comm_size(MPI_COMM_WORLD, &size_);
  MPI_Comm here;
  MPI_Comm_split_type(MPI_COMM_WORLD, MPI_COMM_TYPE_SHARED, rank_, MPI_INFO_NULL, &here);
  MPI_Comm_size(here, &ranks_here_);
  MPI_Comm_free(&here);
}

MpiCluster::~MpiCluster() {
  if (rank_ == 0) {
    Dismiss({});
  } else {
    AwaitDismissal();
  }
  if (complete_) MPI_Finalize();
}

void MpiCluster::Dismiss(const std::set<int>& lost) {
  if (dismissed_) return;
  dismissed_ = true;
  std::set<int> missing;
  for (int rank = 1; rank < size_; ++rank) {
    Send(rank, kStop, "");
    if (!lost.contains(rank)) missing.insert(rank);
  }
  const Clock::time_point end = Clock::now() + kSilence;
  for (Patience patience; !missing.empty() && Clock::now() < end;) {
    if (const std::optional<Message> message = Receive()) {
      if (message->tag == kBye) missing.erase(message->source);
    } else {
      std::this_thread::sleep_for(patience.Next());
    }
  }
  complete_ = missing.empty() && lost.empty();
  for (int rank = 1; rank < size_; ++rank) {
    Send(rank, complete_ ? kFinalize : kLeave, "");
  }
}

void MpiCluster::AwaitDismissal() {
  Clock::time_point heard = Clock::now();
  for (Patience patience; Clock::now() - heard < kSilenceOfRank0;) {
    const std::optional<Message> message = Receive();
    if (!message) {
      std::this_thread::sleep_for(patience.Next());
      continue;
    }
    heard = Clock::now();
    if (message->tag == kStop) Send(0, kBye, "");
    complete_ = message->tag == kFinalize;
    if (message->tag == kFinalize || message->tag == kLeave) return;
  }
}

std::unique_ptr<SweepExecutor> MpiCluster::Share(const SweepStudy& study, LocalExecutor* local) {
  CHECK_EQ(rank_, 0);
  return std::make_unique<ClusterExecutor>(study, this, local);
}

void MpiCluster::Serve(const SweepStudy& study, LocalExecutor* local) {
  Send(0, kHello, Hello(study, local->size()));
  Clock::time_point said = Clock::now(), heard = said;
  Patience patience;
  std::deque<int64_t> waiting;
  while (Clock::now() - heard < kSilenceOfRank0) {
    while (const std::optional<Message> message = Receive()) {
      heard = Clock::now();
      if (message->tag == kStop) {
        Send(0, kBye, "");
        return;
      }
      if (message->tag == kPoint) waiting.push_back(UnpackPoint(message->bytes));
      patience.Reset();
    }
    for (; !waiting.empty() && local->HasRoom(); waiting.pop_front()) local->Start(waiting.front());
    for (const FinishedPoint& finished : local->Wait(patience.Next())) {
      Send(0, kResult, PackPoint(finished.point) + Encode(finished.result));
      said = Clock::now();
      patience.Reset();
    }
    if (Clock::now() - said < kHeartbeat) continue;
    Send(0, kAlive, "");
    said = Clock::now();
  }
}

void MpiCluster::Decline(const std::string& why) { Send(0, kDecline, why); }

}  // namespace saltus
