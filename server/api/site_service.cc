#include "api/site_service.h"

#include "api/convert.h"
#include "api/find.h"
#include "api/paging.h"
#include "api/reactors.h"

namespace soundmap::api {

grpc::ServerUnaryReactor* SiteService::CreateSite(grpc::CallbackServerContext* context,
                                                  const v1::CreateSiteRequest* request,
                                                  v1::Site* response) {
  const auto site = sites_->Create(request->site_id(), request->profile(), request->request_id());
  if (!site.ok()) return Finish(context, site.status());
  *response = ToProto(**site);
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* SiteService::GetSite(grpc::CallbackServerContext* context,
                                               const v1::GetSiteRequest* request,
                                               v1::Site* response) {
  const auto site = FindSite(*sites_, request->name());
  if (!site.ok()) return Finish(context, site.status());
  *response = ToProto(**site);
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* SiteService::ListSites(grpc::CallbackServerContext* context,
                                                 const v1::ListSitesRequest* request,
                                                 v1::ListSitesResponse* response) {
  const auto sites = sites_->List();
  const auto page = PageOf(sites.size(), request->page_size(), request->page_token());
  if (!page.ok()) return Finish(context, page.status());
  for (std::size_t i = page->begin; i < page->end; ++i) {
    *response->add_sites() = ToProto(*sites[i]);
  }
  response->set_next_page_token(page->next_token);
  return Finish(context, absl::OkStatus());
}

grpc::ServerUnaryReactor* SiteService::DeleteSite(grpc::CallbackServerContext* context,
                                                  const v1::DeleteSiteRequest* request,
                                                  v1::DeleteSiteResponse*) {
  const auto name = ParseSite(request->name());
  if (!name.ok()) return Finish(context, name.status());
  return Finish(context, sites_->Delete(*name));
}

}  // namespace soundmap::api
