#include "metrics.h"

#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>
#include <sys/resource.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <fstream>
#include <limits>
#include <vector>

namespace soundmap {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

double Seconds(const timeval& time) {
  return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
}

double ResidentBytes() {
  std::ifstream statm("/proc/self/statm");
  double all_pages = 0.0;
  double resident_pages = 0.0;
  statm >> all_pages >> resident_pages;
  return resident_pages * static_cast<double>(::sysconf(_SC_PAGESIZE));
}

MetricFamily One(const char* name, const char* help, MetricType type, double value) {
  ClientMetric metric;
  (type == MetricType::Counter ? metric.counter.value : metric.gauge.value) = value;
  return {name, help, type, {metric}};
}

}  // namespace

std::string MetricsText(const pipeline::Meters& meters, const api::Access& access) {
  MetricFamily stages{"soundmap_stage_cpu_seconds_total",
                      "Processor time by stage of the work on robots' frames.",
                      MetricType::Counter,
                      {}};
  for (int i = 0; i < pipeline::kStages; ++i) {
    const auto stage = static_cast<pipeline::Stage>(i);
    ClientMetric& metric = stages.metric.emplace_back();
    metric.label.push_back({"stage", pipeline::NameOf(stage)});
    metric.counter.value = std::chrono::duration<double>(meters.stages.cpu_time(stage)).count();
  }
  MetricFamily refusals{"soundmap_refused_calls_total",
                        "Calls without good credentials, beyond what they grant, or too often.",
                        MetricType::Counter,
                        {}};
  const std::array<const char*, api::Access::kRefusals> reasons = {"unauthenticated", "denied",
                                                                   "too_often"};
  for (int i = 0; i < api::Access::kRefusals; ++i) {
    ClientMetric& metric = refusals.metric.emplace_back();
    metric.label.push_back({"reason", reasons[static_cast<std::size_t>(i)]});
    metric.counter.value =
        static_cast<double>(access.refusals(static_cast<api::Access::Refusal>(i)));
  }
  MetricFamily lag{"soundmap_durable_lag_seconds",
                   "Time from the arrival of a frame until it is on the disk.",
                   MetricType::Histogram,
                   {}};
  ClientMetric::Histogram& histogram = lag.metric.emplace_back().histogram;
  for (std::size_t i = 0; i <= pipeline::LagHistogram::kBounds.size(); ++i) {
    histogram.sample_count += static_cast<std::uint64_t>(meters.durable_lag.count(i));
    const double bound_s =
        i < pipeline::LagHistogram::kBounds.size()
            ? std::chrono::duration<double>(pipeline::LagHistogram::kBounds[i]).count()
            : std::numeric_limits<double>::infinity();
    histogram.bucket.push_back({histogram.sample_count, bound_s});
  }
  histogram.sample_sum = std::chrono::duration<double>(meters.durable_lag.sum()).count();
  rusage usage = {};
  ::getrusage(RUSAGE_SELF, &usage);
  return prometheus::TextSerializer().Serialize(
      {stages, refusals,
       One("soundmap_received_bytes_total", "Bytes of the messages that robots have sent.",
           MetricType::Counter, static_cast<double>(meters.received_bytes)),
       One("soundmap_lost_frames_total", "Frames that robots lost before they could send them.",
           MetricType::Counter, static_cast<double>(meters.lost_frames)),
       One("soundmap_replayed_frames_total",
           "Frames whose work was done again when the server started.", MetricType::Counter,
           static_cast<double>(meters.replayed_frames)),
       lag,
       One("soundmap_in_flight_bytes", "Bytes of robots' frames that wait for the disk.",
           MetricType::Gauge, static_cast<double>(meters.bytes_in_flight)),
       One("soundmap_backlog_frames", "Robots' frames on the disk that wait for the map.",
           MetricType::Gauge, static_cast<double>(meters.backlog_frames)),
       One("soundmap_streams", "Robots' streams that are open.", MetricType::Gauge,
           static_cast<double>(meters.streams)),
       One("soundmap_live_streams", "Robots' live streams that are open.", MetricType::Gauge,
           static_cast<double>(meters.live_streams)),
       One("soundmap_watches", "Watches that are open.", MetricType::Gauge,
           static_cast<double>(meters.watches)),
       One("process_cpu_seconds_total", "Processor time of the process.", MetricType::Counter,
           Seconds(usage.ru_utime) + Seconds(usage.ru_stime)),
       One("process_resident_memory_bytes", "Memory of the process.", MetricType::Gauge,
           ResidentBytes())});
}

}  // namespace soundmap
