// saltus_sweep with one more contact model, the gate.
namespace saltus {
int SweepMain(int argc, char** argv);
}  // namespace saltus

int main(int argc, char** argv) { return saltus::SweepMain(argc, argv); }
