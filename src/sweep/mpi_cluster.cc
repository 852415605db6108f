#include <glog/logging.h>
#include <mpi.h>

#include <algorithm>
#include <deque>
#include <functional>
#include <iostream>
#include <list>
#include <map>
#include <optional>
#include <set>
#include <thread>
#include <utility>

#include "sweep/executor.h"

namespace saltus {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::microseconds;

// Everyone says something at least every kHeartbeat: the one thread of a rank only passes messages on, its workers
// compute. Rank 0 may be silent for longer while its disk is busy, most of all before it first hands out points.
constexpr std::chrono::milliseconds kHeartbeat(500);
constexpr std::chrono::seconds kSilence(5);
constexpr std::chrono::seconds kSilenceOfRank0(10);
constexpr std::chrono::minutes kFirstSilenceOfRank0(1);

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

// The time since another rank was heard. Time in which this process did not run itself (the machine slept, the job was
// stopped) does not count: the message may be there by now.
class Silence {
 public:
  void Heard() { length_ = Clock::duration::zero(); }
  // Returns the length of the silence. Must be called again and again.
  Clock::duration Length() {
    const Clock::time_point now = Clock::now();
    length_ += std::min<Clock::duration>(now - std::exchange(looked_, now), kMostBetweenLooks);
    return length_;
  }

 private:
  static constexpr std::chrono::milliseconds kMostBetweenLooks{200};
  Clock::time_point looked_ = Clock::now();
  Clock::duration length_{};
};

// A message that has arrived, if any. Any call makes MPI move messages that are under way.
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

// Returns the greeting of a rank: how many points it takes at a time, and of which study.
std::string Hello(const SweepStudy& study, int workers) {
  return PackPoint(workers) + PackPoint(static_cast<int64_t>(std::hash<std::string>()(study.Description())));
}

// SweepCluster over MPI. All calls of MPI are made here, by one thread.
class MpiCluster : public SweepCluster {
 public:
  MpiCluster();
  ~MpiCluster() override;

  int rank() const override { return rank_; }
  int size() const { return size_; }
  int ranks_here() const override { return ranks_here_; }
  void Tick() override;
  std::unique_ptr<SweepExecutor> Share(const SweepStudy& study, LocalExecutor* local) override;
  bool Serve(const SweepStudy& study, LocalExecutor* local) override;
  void Decline(const std::string& why) override;

  // On rank 0: ends the work of all others and finds out who is still there; `lost` are known not to be. Only the first
  // call does anything; no message is received after it.
  void Dismiss(const std::set<int>& lost);

  // Sends without waiting for the receiver: a rank that is gone never receives.
  void Send(int rank, int tag, std::string bytes);
  // Tells a rank that this one is there; a message to it that is under way still does so too.
  void SayAlive(int rank);

 private:
  struct Outgoing {
    int rank = 0;
    std::string bytes;
    MPI_Request request = MPI_REQUEST_NULL;
  };

  void ForgetSent();
  // Waits, but not for ever, until all has been taken.
  void SendRest();
  // On other ranks: waits for rank 0 to say how to leave.
  void AwaitDismissal();

  std::list<Outgoing> outgoing_;  // not taken yet
  std::chrono::steady_clock::time_point ticked_;
  bool rank_0_lost_ = false;
  bool dismissed_ = false;
  bool complete_ = false;  // everyone is there at the end
  int rank_ = 0;
  int size_ = 1;
  int ranks_here_ = 1;
};

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
    const int rank = IdleRank();
    CHECK_GT(rank, 0);
    away_[point] = rank;
    --ranks_[rank].room;
    cluster_.Send(rank, kPoint, PackPoint(point));
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

  int IdleRank() const {
    for (size_t rank = 1; rank < ranks_.size(); ++rank) {
      if (!ranks_[rank].lost && ranks_[rank].room > 0) return static_cast<int>(rank);
    }
    return -1;
  }

  bool HasFreeWorker() const { return local_.HasRoom() || IdleRank() > 0; }

  // Whether a rank has joined.
  bool ReceiveAll(std::vector<FinishedPoint>* points) {
    bool hello = false;
    while (const std::optional<Message> message = Receive()) {
      Rank& rank = ranks_[message->source];
      rank.heard = Clock::now();
      // The rank is merely slow: its points have been given to others, but it can go on.
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
    // The rank is asked for nothing any more.
    ranks_[rank] = Rank();
    std::cerr << "rank " << rank << " is left out: " << why << std::endl;
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
      std::cerr << "rank " << rank << " is silent; its points go to others" << std::endl;
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
      if (!ranks_[rank].lost) cluster_.SayAlive(static_cast<int>(rank));
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
  // The messages are not freed if some are still under way to ranks that are gone: MPI needs their memory until the
  // process ends.
  if (!complete_) new std::list<Outgoing>(std::move(outgoing_));
}

void MpiCluster::Send(int rank, int tag, std::string bytes) {
  ForgetSent();
  Outgoing& message = outgoing_.emplace_back();
  message.rank = rank;
  message.bytes = std::move(bytes);
  MPI_Isend(message.bytes.data(),
            static_cast<int>(message.bytes.size()),
            MPI_BYTE,
            rank,
            tag,
            MPI_COMM_WORLD,
            &message.request);
}

void MpiCluster::SayAlive(int rank) {
  ForgetSent();
  // A message that has not been taken yet serves as a sign of life too.
  const bool waits = std::ranges::find(outgoing_, rank, &Outgoing::rank) != outgoing_.end();
  if (!waits) Send(rank, kAlive, "");
}

void MpiCluster::ForgetSent() {
  outgoing_.remove_if([](Outgoing& message) {
    int sent = 0;
    // An error ends it too: who should have had it is gone.
    return MPI_Test(&message.request, &sent, MPI_STATUS_IGNORE) != MPI_SUCCESS || sent != 0;
  });
}

void MpiCluster::SendRest() {
  const Clock::time_point end = Clock::now() + kSilence;
  for (Patience patience; !outgoing_.empty() && Clock::now() < end; std::this_thread::sleep_for(patience.Next())) {
    ForgetSent();
  }
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
  SendRest();
}

void MpiCluster::AwaitDismissal() {
  Silence silence;
  const Clock::duration most = dismissed_ ? Clock::duration(kSilenceOfRank0) : Clock::duration(kFirstSilenceOfRank0);
  for (Patience patience; !rank_0_lost_;) {
    const std::optional<Message> message = Receive();
    ForgetSent();
    if (!message) {
      rank_0_lost_ = silence.Length() > most;
      std::this_thread::sleep_for(patience.Next());
      continue;
    }
    silence.Heard();
    if (message->tag == kStop) Send(0, kBye, "");
    complete_ = message->tag == kFinalize;
    if (message->tag == kFinalize || message->tag == kLeave) return;
  }
}

void MpiCluster::Tick() {
  if (Clock::now() - ticked_ < kHeartbeat) return;
  ticked_ = Clock::now();
  for (int rank = 1; rank < size_; ++rank) SayAlive(rank);
}

std::unique_ptr<SweepExecutor> MpiCluster::Share(const SweepStudy& study, LocalExecutor* local) {
  CHECK_EQ(rank_, 0);
  return std::make_unique<ClusterExecutor>(study, this, local);
}

bool MpiCluster::Serve(const SweepStudy& study, LocalExecutor* local) {
  Send(0, kHello, Hello(study, local->size()));
  Clock::time_point said = Clock::now();
  Silence silence;
  Clock::duration most = kFirstSilenceOfRank0;
  Patience patience;
  std::deque<int64_t> waiting;
  for (;;) {
    while (const std::optional<Message> message = Receive()) {
      silence.Heard();
      most = kSilenceOfRank0;
      if (message->tag == kStop) {
        dismissed_ = true;
        Send(0, kBye, "");
        return true;
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
    if (silence.Length() > most) {
      rank_0_lost_ = true;
      std::cerr << "rank 0 is silent: rank " << rank_ << " ends; what it was computing is lost" << std::endl;
      return false;
    }
    if (Clock::now() - said < kHeartbeat) continue;
    SayAlive(0);
    said = Clock::now();
  }
}

void MpiCluster::Decline(const std::string& why) { Send(0, kDecline, why); }

}  // namespace

std::unique_ptr<SweepCluster> JoinMpi() { return std::make_unique<MpiCluster>(); }

}  // namespace saltus
