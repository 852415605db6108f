#include "siconos_motion.h"

#include <SiconosKernel.hpp>
#include <array>
#include <functional>
#include <utility>

namespace saltus {
namespace {

// A gap of one body, whose row and its rate the functions of a derived class give.
class Contact : public LagrangianScleronomousR {
 public:
  // For an evaluation of the motion Siconos computes the rows of contacts, the forces of contacts, and then the
  // accelerations without contact and the mass matrix, in this order: forces are those of the state of the evaluation
  // before. The derived class that has rows to compute calls this first, which computes the latter two.
  std::function<void()> refresh;

  explicit Contact(int size) {
    _jachq = std::make_shared<SimpleMatrix>(1, size);
    _dotjachq = std::make_shared<SimpleMatrix>(1, size);
    _dotjacqhXqdot = std::make_shared<SiconosVector>(1);
  }
};

class Corner final : public Contact {
 public:
  explicit Corner(int corner) : Contact(3), along_(BouncingBox::Along(corner)), across_(BouncingBox::Across(corner)) {}
  void computeh(const BlockVector& q, BlockVector&, SiconosVector& y) override {
    y(0) = q(1) + along_ * std::sin(q(2)) + across_ * std::cos(q(2));
  }
  void computeJachq(const BlockVector& q, BlockVector&) override {
    _jachq->setValue(0, 1, 1);
    _jachq->setValue(0, 2, along_ * std::cos(q(2)) - across_ * std::sin(q(2)));
  }
  void computeDotJachq(const BlockVector& q, BlockVector&, const BlockVector& v) override {
    _dotjachq->setValue(0, 2, -(along_ * std::sin(q(2)) + across_ * std::cos(q(2))) * v(2));
  }

 private:
  const double along_, across_;
};

class Pendulum final : public LagrangianDS {
 public:
  Pendulum(const SP::SiconosVector& q, const SP::SiconosVector& v) : LagrangianDS(q, v) {
    _mass = std::make_shared<SimpleMatrix>(2, 2);
    _hasConstantMass = false;
    _fGyr = std::make_shared<SiconosVector>(2);
  }
  void computeMass() override { computeMass(q()); }
  void computeMass(SP::SiconosVector position) override {
    double M[4];
    equations_.Mass<double>(position->getArray(), nullptr, M);
    for (int i = 0; i < 4; ++i) _mass->setValue(i / 2, i % 2, M[i]);
  }
  void computeFGyr() override { computeFGyr(q(), velocity()); }
  void computeFGyr(SP::SiconosVector position, SP::SiconosVector velocity) override {
    double h[2];
    equations_.Force<double>(0, position->getArray(), velocity->getArray(), nullptr, nullptr, h);
    for (int i = 0; i < 2; ++i) _fGyr->setValue(i, -h[i]);
  }

 private:
  const SlidingPendulum equations_{};
};

class Tip final : public Contact {
 public:
  Tip() : Contact(2) {}
  void computeh(const BlockVector& q, BlockVector&, SiconosVector& y) override {
    const double angles[] = {q(0), q(1)};
    y(0) = equations_.Gap<double>(0, angles, nullptr);
  }
  void computeJachq(const BlockVector& q, BlockVector&) override {
    if (refresh) refresh();
    for (int i = 0; i < 2; ++i) _jachq->setValue(0, i, SlidingPendulum::kLength[i] * std::sin(q(i)));
  }
  void computeDotJachq(const BlockVector& q, BlockVector&, const BlockVector& v) override {
    for (int i = 0; i < 2; ++i) _dotjachq->setValue(0, i, SlidingPendulum::kLength[i] * std::cos(q(i)) * v(i));
  }

 private:
  const SlidingPendulum equations_{};
};

SP::SiconosVector Vector(const double* begin, int size) {
  return std::make_shared<SiconosVector>(std::vector<double>(begin, begin + size));
}

class EventDrivenMotion final : public SiconosMotion {
 public:
  explicit EventDrivenMotion(double duration)
      : duration_(duration), model_(std::make_shared<NonSmoothDynamicalSystem>(0, duration)) {}

  void AddBody(std::shared_ptr<LagrangianDS> body) {
    model_->insertDynamicalSystem(body);
    bodies_.push_back(std::move(body));
  }
  // Adds a contact of the last body.
  void AddContact(const std::shared_ptr<Contact>& contact, double restitution) {
    model_->link(std::make_shared<Interaction>(std::make_shared<NewtonImpactNSL>(restitution), contact),
                 bodies_.back());
    contacts_.push_back(contact);
  }
  // After all bodies and contacts.
  void Start(double tolerance) {
    simulation_ = std::make_shared<EventDriven>(model_, std::make_shared<TimeDiscretisation>(0, duration_));
    const auto integrator = std::make_shared<LsodarOSI>();
    simulation_->insertIntegrator(integrator);
    simulation_->insertNonSmoothProblem(std::make_shared<LCP>(), SICONOS_OSNSP_ED_IMPACT);
    simulation_->insertNonSmoothProblem(std::make_shared<LCP>(), SICONOS_OSNSP_ED_SMOOTH_ACC);
    simulation_->initialize();
    integrator->setTol(1, tolerance, tolerance);
    integrator->setMaxNstep(1000000);
    for (const auto& contact : contacts_) contact->refresh = [integrator] { integrator->computeRhs(0); };
  }
  int Run() override {
    constexpr int kNonsmooth = 2;
    int impacts = 0;
    while (simulation_->startingTime() < duration_) {
      simulation_->advanceToEvent();
      impacts += simulation_->eventsManager()->nextEvent()->getType() == kNonsmooth ? 1 : 0;
      simulation_->processEvents();
    }
    return impacts;
  }
  std::vector<double> State() const override {
    std::vector<double> state;
    const auto append = [&](const SiconosVector& numbers) {
      for (unsigned i = 0; i < numbers.size(); ++i) state.push_back(numbers.getValue(i));
    };
    for (const auto& body : bodies_) append(*body->q());
    for (const auto& body : bodies_) append(*body->velocity());
    return state;
  }

 private:
  const double duration_;
  SP::NonSmoothDynamicalSystem model_;
  std::vector<std::shared_ptr<LagrangianDS>> bodies_;
  std::vector<std::shared_ptr<Contact>> contacts_;
  std::shared_ptr<EventDriven> simulation_;
};

}  // namespace

std::unique_ptr<SiconosMotion> BoxesBySiconos(const std::vector<double>& initial, double duration, double tolerance) {
  const int count = static_cast<int>(initial.size()) / 6;
  auto motion = std::make_unique<EventDrivenMotion>(duration);
  for (int i = 0; i < count; ++i) {
    const double* q = &initial[3 * i];
    const auto mass = std::make_shared<SimpleMatrix>(3, 3);
    mass->setValue(0, 0, BouncingBox::kMass);
    mass->setValue(1, 1, BouncingBox::kMass);
    mass->setValue(2, 2, BouncingBox::kInertia);
    const auto body = std::make_shared<LagrangianLinearTIDS>(Vector(q, 3), Vector(q + 3 * count, 3), mass);
    const std::array<double, 3> weight = {0, -BouncingBox::kMass * BouncingBox::kGravity, 0};
    body->setFExtPtr(Vector(weight.data(), 3));
    motion->AddBody(body);
    for (int corner = 0; corner < 4; ++corner) {
      motion->AddContact(std::make_shared<Corner>(corner), BouncingBox::kRestitution);
    }
  }
  motion->Start(tolerance);
  return motion;
}

std::unique_ptr<SiconosMotion> PendulumBySiconos(const std::vector<double>& initial, double duration,
                                                 double tolerance) {
  auto motion = std::make_unique<EventDrivenMotion>(duration);
  motion->AddBody(std::make_shared<Pendulum>(Vector(initial.data(), 2), Vector(initial.data() + 2, 2)));
  motion->AddContact(std::make_shared<Tip>(), 0);
  motion->Start(tolerance);
  return motion;
}

}  // namespace saltus
