#include "api/site_service.h"

#include "absl/strings/str_cat.h"
#include "api/convert.h"
#include "api/find.h"
#include "api/paging.h"
#include "api/reactors.h"

namespace soundmap::api {

grpc::ServerUnaryReactor* SiteService::CreateSite(grpc::CallbackServerContext* context,
                                                  const v1::CreateSiteRequest* request,
                                                  v1::Site* response) {
  const AuditedFinish finish(access_, context, "create site", request->site_id());
  const auto caller = access_->Check(*context, Right::kAdmin, request->site_id());
  if (!caller.ok()) return finish(caller.status());
  std::vector<pipeline::Band> bands;
  for (const v1::Band& band : request->bands()) bands.push_back(FromProto(band));
  const auto site =
      sites_->Create(request->site_id(), request->profile(), request->request_id(), bands);
  if (!site.ok()) return finish(site.status());
  *response = ToProto(**site);
  return finish(absl::OkStatus());
}

grpc::ServerUnaryReactor* SiteService::GetSite(grpc::CallbackServerContext* context,
                                               const v1::GetSiteRequest* request,
                                               v1::Site* response) {
  const auto site = FindSite(*sites_, request->name(), {access_, context, Right::kRead});
  if (!site.ok()) return Finish(context, site.status());
  *response = ToProto(**site);
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* SiteService::ListSites(grpc::CallbackServerContext* context,
                                                 const v1::ListSitesRequest* request,
                                                 v1::ListSitesResponse* response) {
  const auto caller = access_->CallerOf(*context);
  if (!caller.ok()) return Finish(context, caller.status());
  auto sites = sites_->List();
  std::erase_if(sites,
                [&](const auto& site) { return !caller->grant.Reaches(site->record().site); });
  const auto page = PageOf(sites.size(), request->page_size(), request->page_token());
  if (!page.ok()) return Finish(context, page.status());
  for (std::size_t i = page->begin; i < page->end; ++i) {
    *response->add_sites() = ToProto(*sites[i]);
  }
  response->set_next_page_token(page->next_token);
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* SiteService::UpdateSite(grpc::CallbackServerContext* context,
                                                  const v1::UpdateSiteRequest* request,
                                                  v1::Site* response) {
  const AuditedFinish finish(access_, context, "update site", request->site().name());
  const auto site = FindSite(*sites_, request->site().name(), {access_, context, Right::kAdmin});
  if (!site.ok()) return finish(site.status());
  if (request->update_mask().paths().empty()) {
    return finish(absl::InvalidArgumentError("the update mask names no field"));
  }
  for (const std::string& path : request->update_mask().paths()) {
    if (path != "keep_frames_s") {
      return finish(absl::InvalidArgumentError(
          absl::StrCat("the field '", path, "' of a site cannot be changed")));
    }
  }
  const absl::Status kept = (*site)->KeepFrames(request->site().keep_frames_s());
  if (!kept.ok()) return finish(kept);
  *response = ToProto(**site);
  return finish(absl::OkStatus());
}

grpc::ServerUnaryReactor* SiteService::DeleteSite(grpc::CallbackServerContext* context,
                                                  const v1::DeleteSiteRequest* request,
                                                  v1::DeleteSiteResponse*) {
  const AuditedFinish finish(access_, context, "delete site", request->name());
  const auto site = FindSite(*sites_, request->name(), {access_, context, Right::kAdmin});
  if (!site.ok()) return finish(site.status());
  return finish(sites_->Delete((*site)->record().site));
}

}  // namespace soundmap::api
